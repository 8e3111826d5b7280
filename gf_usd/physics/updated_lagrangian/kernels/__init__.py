"""Taichi kernels of an Updated Lagrangian substep."""
