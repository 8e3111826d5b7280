"""The experiments of the GaussianFlesh paper, repeated and compared with its figures."""
