"""Values, units and small mathematics that every package may import."""

__version__ = "0.1.0"

FAST_START = "GF_USD_FAST_START"  # environment variable; "0" turns off all shortcuts of the start
