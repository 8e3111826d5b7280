"""Laws and materials as data: the names and parameters of laws, and presets."""
