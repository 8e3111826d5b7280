"""Values, units and small mathematics that every package may import."""

__version__ = "0.1.0"
