"""Obstacles: their motion, contact of their edges and corners, and how deep these are in bodies."""
