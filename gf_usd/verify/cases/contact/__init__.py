"""Contact: friction, Hertz's impact, collisions, a body that meets itself."""
