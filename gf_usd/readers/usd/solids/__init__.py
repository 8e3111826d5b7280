"""Prims that are bodies without being meshes: tetrahedra, and clouds of points."""
