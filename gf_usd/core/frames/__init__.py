"""The immutable values of a simulation that cross packages.

SI, in the source stage's world frame and up axis; quaternions (w, x, y, z); linear Rec. 709.
"""
