"""The cases of ``gf-usd verify``, one physical question a file."""
