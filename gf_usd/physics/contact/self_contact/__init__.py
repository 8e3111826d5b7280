"""Contact of a body with itself: patches (broad phase), sample mesh, search (narrow phase)."""
