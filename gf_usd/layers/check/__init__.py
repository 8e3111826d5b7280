"""The rules of ``gf-usd check``, one file per family; importing this package fills the registry.

A new rule is a function with the decorator ``rule`` in one of these files, or in a new one that is
listed below; a test then requires a file that violates it.
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
