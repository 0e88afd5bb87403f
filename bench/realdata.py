"""Data by others that benchmarks measure, below a folder that the person at the keyboard names."""

from __future__ import annotations

from pathlib import Path

HOUSE = Path("scene_aws_small_house", "house.glb")
"""The AWS small house below the folder of real data; its authors' models are in `MODELS`."""

MODELS = Path("assets")
"""The house's models, a library."""

HOUSE_VOXEL_M = 0.03
"""Voxel of the house's scan [m]: it is 19 m long."""

LIVING_ROOM = Path("rgbd_open3d_livingroom_synth")
"""A synthetic living room's posed frames, a scan as it is."""
