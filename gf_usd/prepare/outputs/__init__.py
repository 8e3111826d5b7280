"""Output files of a bake: their names, and whether they may be written."""
