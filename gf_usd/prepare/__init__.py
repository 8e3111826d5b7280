"""The options and the asset become a Plan; nothing is simulated and nothing is written."""
