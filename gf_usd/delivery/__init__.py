"""Turns a bake into a small file of joints or blend shapes, for game engines, web pages and phones."""
