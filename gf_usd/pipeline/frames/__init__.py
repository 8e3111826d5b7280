"""Converts a solver's frames to the samples that are written."""
