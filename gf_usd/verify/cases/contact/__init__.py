"""Contact: Coulomb friction, Hertz's impact, collisions and self-contact."""
