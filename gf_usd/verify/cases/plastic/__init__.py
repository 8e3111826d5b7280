"""Laws that flow: metals, paste."""
