"""The HTML report of a bake."""
