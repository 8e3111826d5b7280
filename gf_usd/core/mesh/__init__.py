"""Meshes of polygons and triangles: topology, area and volume, subdivision, triangulation.

Nothing here depends on a file format.  Triangles are (T, 3) indices, counter-clockwise seen from
outside; lengths are in whatever unit the points have.
"""
