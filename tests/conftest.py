"""Marks the root of the tests, so that every folder of them can import the helpers that lie here."""
