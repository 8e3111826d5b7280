"""The material of every particle: parts of bodies, presets, what a stage states and paints."""
