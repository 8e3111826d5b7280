"""The table of options of a bake, and the request made from it."""
