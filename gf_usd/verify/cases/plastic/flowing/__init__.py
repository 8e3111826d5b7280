"""What flows without end: sand, fluids, pastes, by the Updated Lagrangian solver."""
