"""Readers of mesh files (OBJ, PLY, OFF, STL, glTF, FBX), and their conversion to USD layers."""
