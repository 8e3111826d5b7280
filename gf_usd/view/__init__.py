"""Scenes and recordings become pictures, films, an HTML page and a window."""
