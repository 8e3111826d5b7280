"""Health of a bake: the log of its frames, and warnings about what is in it."""
