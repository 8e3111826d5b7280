"""Reader of USD stages: geometry, shading and skeletons, as an `Asset`."""
