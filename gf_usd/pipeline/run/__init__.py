"""Runs a prepared bake: simulates each variant, writes its cache, and publishes the files."""
