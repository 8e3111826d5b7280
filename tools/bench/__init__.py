"""Benchmarks of gf-usd, alone and compared with other solvers."""
