"""Poses of a scan's frames: held against its depth, refined where they do not fit, and found where there are none."""
