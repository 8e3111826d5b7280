"""A solid becomes particles, quadrature points of the cells it cuts, and contact samples."""
