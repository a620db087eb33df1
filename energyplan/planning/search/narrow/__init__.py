"""Narrow passages: searched on a grid, with a shrunken footprint, out of ends; or proven closed."""
