"""Values, units and small mathematics that every package may import."""

__version__ = "0.1.0"

PACKAGE_SUFFIX = ".usdz"
USD_SUFFIXES = (".usd", ".usda", ".usdc", PACKAGE_SUFFIX)
CACHE_SUFFIX = ".cache.usdc"  # of the layer with the time samples of a bake
FAST_START = "GF_USD_FAST_START"  # environment variable; "0" turns off all shortcuts of the start
