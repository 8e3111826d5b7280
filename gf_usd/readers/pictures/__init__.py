"""A stage at a time becomes a Scene to draw, and a bake becomes a Recording."""
