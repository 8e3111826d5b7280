"""Constitutive laws: energy, stress and moduli of each."""
