"""The background grid: interpolation, dependent nodes, pins and embedded points."""
