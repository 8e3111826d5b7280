"""A USD stage becomes an Asset, and what it says about its bake."""
