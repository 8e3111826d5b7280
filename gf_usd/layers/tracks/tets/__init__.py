"""Bodies as TetMeshes, with what pins hold of them, for other simulators."""
