"""Contact planes: what they hold, what carries them, and what of them lasts past a detection."""
