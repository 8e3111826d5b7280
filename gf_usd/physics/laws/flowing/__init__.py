"""Laws with unbounded flow, for the Updated Lagrangian solver: sand, snow, fluids."""
