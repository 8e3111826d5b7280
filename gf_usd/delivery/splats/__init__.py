"""Gaussians of a bake in delivered files: bound to the joints of bodies, or as samples."""
