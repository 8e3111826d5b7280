"""Estimates material values from what was observed: least squares over simulations."""
