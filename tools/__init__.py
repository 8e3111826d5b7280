"""Programs for development: they generate files, measure and verify."""
