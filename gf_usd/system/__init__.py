"""Services of the system: atomic files, locks, memory, processes, Taichi, the USD schema."""
