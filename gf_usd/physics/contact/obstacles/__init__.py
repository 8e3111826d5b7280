"""Obstacles: where they are, their edges and corners, and how far these are in bodies."""
