"""UsdPhysics prims become bodies, materials, colliders and filters."""
