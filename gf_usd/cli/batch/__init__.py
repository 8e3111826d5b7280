"""gf-usd batch: plans, runs and exports many bakes."""
