"""Images of a stage at any time code, and the options that select them."""
