"""Subdivision of meshes with long edges, in a USD layer over the stage."""
