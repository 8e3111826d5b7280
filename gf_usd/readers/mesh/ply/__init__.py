"""PLY files: their tables, and the polygons in them."""
