"""What the machine gives: atomic files, locks, memory, processes, Taichi, the USD schema."""
