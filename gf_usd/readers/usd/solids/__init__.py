"""Bodies that are not meshes: TetMesh and Points prims, and bind poses of deformable bodies."""
