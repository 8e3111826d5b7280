"""The renderer of a `Scene`: a rasterizer with shadow maps that needs neither a GPU nor OpenGL."""
