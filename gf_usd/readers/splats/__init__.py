"""Reading, conversion to USD, and writing of Gaussian splat files (PLY, SPZ, .splat)."""
