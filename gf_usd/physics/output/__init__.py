"""Output of particles: Gaussians, and surfaces of flows."""
