"""The flesh of a character: cores that bones prescribe, and goals of springs."""
