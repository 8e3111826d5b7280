"""What of a solid hangs together: bodies among its surfaces, limbs in the cells of the grid."""
