"""Makes a solid, particles, contact samples and skins from surfaces."""
