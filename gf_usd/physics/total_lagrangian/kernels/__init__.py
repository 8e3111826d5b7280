"""Taichi kernels of a Total Lagrangian substep."""
