"""What was asked and what the asset says become a Plan; nothing runs and nothing is written."""
