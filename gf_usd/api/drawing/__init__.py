"""Pictures of a stage at any of its times, and the options that say which."""
