"""Simulation: the solvers, their contact, constitutive laws and grid, and their output."""
