"""Frames become USD layers, and layers are checked."""
