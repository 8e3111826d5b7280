"""Skeletons of UsdSkel: meshes posed by them, and their bones and motion for `--flesh`."""
