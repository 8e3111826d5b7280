"""Solid and flowing bodies in one bake: both solvers side by side, and the contact between them."""
