"""Skeleton-driven simulation: bone cores (kinematic), springs to the skinned pose, and limits."""
