"""Bake settings in a USD stage: options, painted values, regions and materials."""
