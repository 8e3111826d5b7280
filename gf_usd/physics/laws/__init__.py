"""Constitutive laws: energy, stress, return mapping and moduli of each."""
