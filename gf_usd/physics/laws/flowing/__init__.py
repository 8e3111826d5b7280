"""Laws that flow without end, for the Updated Lagrangian solver: sand, snow, fluids."""
