"""What a USD stage says about its own bake: settings, painted values, regions and materials."""
