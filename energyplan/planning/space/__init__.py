"""A planning problem compiled for kernels: prices, motions, slopes, cost-to-go, reachability."""
