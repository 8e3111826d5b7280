"""Time samples of each kind of prim that a bake writes."""
