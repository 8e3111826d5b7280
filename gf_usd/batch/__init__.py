"""Batches of bakes: a manifest becomes jobs, which run on this machine, a cluster or a farm."""
