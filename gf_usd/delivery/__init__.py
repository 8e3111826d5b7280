"""Turns a bake into a small file of joints or blend shapes, for engines, web pages and phones."""
