"""Signed distance of points to surfaces, and winding numbers."""
