"""Thin parts of a solid: thickness measurement, detection of unfilled parts, thickening."""
