"""Files of captured Gaussians are read, converted and written."""
