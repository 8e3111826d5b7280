"""A window that plays a bake, drawn by open3d."""
