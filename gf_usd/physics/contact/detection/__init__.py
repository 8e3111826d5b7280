"""Which surfaces contact samples face: broad phase, narrow phase, and the search of near pairs."""
