"""Bodies as TetMeshes with attachments to pins, for other simulators."""
