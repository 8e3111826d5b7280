"""The renderer: a Scene becomes pixels, on a CPU without GL."""
