"""Geometry processing: meshes to solids, particles, contact samples and skinning weights."""
