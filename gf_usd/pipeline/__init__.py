"""A Plan becomes files: budget, run, frames, checkpoints, health and result."""
