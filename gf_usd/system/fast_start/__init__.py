"""Faster start of commands: imports of libraries, and Taichi's lookup of compiled kernels."""
