"""Warm processes, each for one command of gf-usd after the other, and their server."""
