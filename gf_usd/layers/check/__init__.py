"""The rules of ``gf-usd check``, one file for each family; importing this fills the registry.

A new rule is a function with the decorator ``rule`` in one of these files (or a new one, named
below); the tests then ask for a file that breaks it.
"""

from gf_usd.layers.check import arrays, motion, structure, values
from gf_usd.layers.check.base import RULES, Finding, Rule, Severity, Skip, rule

__all__ = [
    "RULES",
    "Finding",
    "Rule",
    "Severity",
    "Skip",
    "arrays",
    "motion",
    "rule",
    "structure",
    "values",
]
