"""The Updated Lagrangian MPM solver, for flowing materials and for comparison."""
