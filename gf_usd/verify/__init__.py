"""Accuracy cases: the production solver against closed forms and published numbers.

A room above rooms: it fills bodies (geometry), moves them (physics) and compares.  No other room
knows it.  `registry.CASES` lists the cases, `run.verify` runs them.
"""
