"""A call as a guest of another program, in this process or in a separate one."""
