"""Flowing materials: sand, fluids and pastes, with the Updated Lagrangian solver."""
