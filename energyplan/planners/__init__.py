"""Planners: one problem in, one plan out."""
