"""Long acceptance runs: endurance, recovery and accuracy."""
