"""What may be asked of a bake: one table of options, and what was asked out of it."""
