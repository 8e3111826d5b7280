"""The start of a command without the detours of libraries: their imports, and Taichi's kernels."""
