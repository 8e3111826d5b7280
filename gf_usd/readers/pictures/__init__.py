"""Reading of stages for rendering: a `Scene` at one time, or a `Recording` of an animation."""
