"""Narrow passages: found where no pose tested is free, searched on a grid, or proven closed."""
