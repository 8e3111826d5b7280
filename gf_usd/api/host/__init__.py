"""Calls from another program, in its process or in a separate one."""
