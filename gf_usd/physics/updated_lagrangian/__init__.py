"""The Updated Lagrangian MPM solver, for comparison."""
