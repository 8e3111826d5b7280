"""Contact of surface samples with the floor, other bodies and obstacles."""
