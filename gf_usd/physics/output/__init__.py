"""What particles are written as: Gaussians, and the surfaces of what flows."""
