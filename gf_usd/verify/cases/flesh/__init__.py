"""Flesh: springs, driven parts, and rigid ones."""
