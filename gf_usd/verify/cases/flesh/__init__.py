"""Flesh: goal springs, driven parts and rigid regions."""
