"""Makes a plan from an asset that was read."""
