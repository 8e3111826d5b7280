"""Particles of a solid, as quadrature points of the grid cells, and contact samples."""
