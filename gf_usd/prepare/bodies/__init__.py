"""The bodies of a bake: which surfaces form one, which can touch, and their initial velocities."""
