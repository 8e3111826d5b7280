"""Laws and materials as data: what a law is called, its parameters, and presets."""
