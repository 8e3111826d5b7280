"""What gf-usd costs, beside other solvers and by itself."""
