"""What a bake costs: an estimate before it begins, and a forecast while it runs."""
