"""Compares the solver with closed-form solutions and published results."""
