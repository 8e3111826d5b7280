"""Surfaces become a solid, particles, contact samples and skins."""
