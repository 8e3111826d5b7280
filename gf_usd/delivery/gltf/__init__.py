"""A bake as a binary glTF 2.0 file: written, and read back to measure its error."""
