"""Thin parts of a solid: measured, found where particles do not reach, thickened."""
