"""Reader of bake settings in USD (GaussianFleshBakeAPI, primvars, regions), and of bake results."""
