"""The cases of ``gf-usd verify``, one physical problem per file."""
