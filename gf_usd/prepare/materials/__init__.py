"""The material of every particle: from presets, from the stage, and painted."""
