"""Scan formats: what a folder of scans may hold. The objects are in `tasks.capture`."""

from __future__ import annotations

SCAN_FORMATS = (
    "scannet", "scannetpp", "threerscan", "replica_v1", "matterport3d", "multiscan", "arkitscenes", "s3dis", "tum_rgbd", "stray_scanner",
    "record3d", "roomplan", "posed_rgbd", "glb", "bare_mesh", "point_cloud",
)  # fmt: skip
"""In the order in which they are looked for. `bare_mesh` and `point_cloud` take any folder with one file of theirs in it: they are last."""
