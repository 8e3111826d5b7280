"""What is measured of a bake beside its frames: surfaces inside bodies, and how certain it is."""
