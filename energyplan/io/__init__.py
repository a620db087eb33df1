"""Files in and out: configuration, foreign drive logs, maps, route graphs."""
