"""Writes frames into USD layers, and checks layers."""
