"""Signed distance of points to surfaces, and how often these wind around a point."""
