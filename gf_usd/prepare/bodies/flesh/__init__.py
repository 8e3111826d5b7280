"""The flesh of characters (`--flesh`): whose it is, their animation, pins at bones and springs."""
