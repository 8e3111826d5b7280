"""Makes a Plan from the options and the asset; nothing is simulated or written."""
