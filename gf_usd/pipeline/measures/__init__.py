"""Measurements of a bake in addition to its frames: surfaces inside bodies, and its uncertainty."""
