"""Warm processes, each of which runs one command of gf-usd after another, and their server."""
