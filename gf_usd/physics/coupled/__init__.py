"""Solid and flowing bodies in one bake: both solvers together, and the contact between them."""
