"""The Total Lagrangian solver."""
