"""Mesh files become surfaces, and USD layers that hold them."""
