"""Cells of the solver's grid cut by a solid: exact moments, and particles that integrate them."""
