"""The bodies of a bake: what falls as one, what may touch, and how each starts."""
