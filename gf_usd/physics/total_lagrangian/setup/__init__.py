"""The constant data of Total Lagrangian bodies, built from particles and materials."""
