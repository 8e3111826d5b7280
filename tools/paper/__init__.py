"""The experiments of the GaussianFlesh paper, run again and set beside its figures."""
