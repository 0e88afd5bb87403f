"""Scan formats: what a folder of scans may hold. The objects are in `tasks.capture`."""

from __future__ import annotations

SCAN_FORMATS = (
    "scannet", "scannetpp", "threerscan", "replica_v1", "matterport3d", "multiscan", "arkitscenes", "tum_rgbd", "stray_scanner", "record3d",
    "roomplan", "posed_rgbd", "glb", "bare_mesh",
)  # fmt: skip
"""In the order in which they are looked for: `bare_mesh`, which takes any folder with one mesh in it, is the last."""
