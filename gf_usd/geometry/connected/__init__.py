"""Connectivity of a solid: bodies among its surfaces, and connected parts in the grid cells."""
