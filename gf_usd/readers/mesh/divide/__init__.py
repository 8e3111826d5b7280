"""Meshes with shorter edges, in a USD layer over the stage that has them."""
