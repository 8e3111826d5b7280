"""Reader of PLY files: element tables, and polygon meshes."""
