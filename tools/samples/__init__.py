"""How the assets of `samples/` are made."""
