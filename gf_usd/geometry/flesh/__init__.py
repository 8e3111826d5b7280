"""The flesh of a character: what its bones hold, and where springs draw it."""
