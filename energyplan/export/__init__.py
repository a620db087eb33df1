"""What other planners read: primitives of a lattice, a route graph, a table of energies."""
