"""The reference grid: its interpolation operators, and how it is laid around particles."""
