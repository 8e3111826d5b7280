"""Contact against closed forms: friction, Hertz's impact, collisions."""
