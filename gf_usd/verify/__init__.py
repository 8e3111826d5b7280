"""The solver against closed forms and published numbers."""
