"""glTF 2.0: the container, its primitives and materials, its nodes, skins and animation."""
