"""Reader of glTF 2.0: container, primitives, materials, nodes, skins and animation."""
