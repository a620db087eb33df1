"""The lattice planner: a coarse first plan, searches from coarse to fine, refinement."""
