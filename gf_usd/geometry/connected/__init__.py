"""Connected parts of a solid: bodies among its surfaces, limbs in the cells of the grid."""
