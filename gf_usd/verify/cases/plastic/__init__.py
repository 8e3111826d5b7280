"""Plastic laws: metals, foam, paste."""
