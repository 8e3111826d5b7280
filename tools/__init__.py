"""Programs that make, measure and judge: for those who work on gf-usd, from its source."""
