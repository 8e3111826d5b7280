"""Particles become frames."""
