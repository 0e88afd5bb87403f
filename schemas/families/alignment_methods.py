"""Alignment methods: how the pose of an asset on a scanned instance is found. The objects are in `tasks.alignment`."""

from __future__ import annotations

ALIGNMENT_METHODS = ("refined", "heuristic", "fixed_pose", "free_pose", "acdc")
"""The first is the default."""
