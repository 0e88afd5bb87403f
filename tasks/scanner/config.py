"""How a virtual scan is taken and written."""

from __future__ import annotations

import dataclasses
from typing import Literal


@dataclasses.dataclass(frozen=True)
class ScannerConfig:
    """Camera, walk, noise and file variants of a virtual scan."""

    color_size: tuple[int, int] = (640, 480)  # Depth has half of it, as color cameras resolve more than depth sensors.
    horizontal_fov_radians: float = 1.15  # 66 degrees: between a Kinect (57) and a phone (70).
    min_range_m: float = 0.35  # Nearer, structured light sees nothing.
    max_range_m: float = 4.5  # Beyond, its noise exceeds two voxels.
    max_frames: int = 90  # Views after which more add little to a room of 20 m2; see `frames_per_m2`.
    frames_per_m2: float = 3.5  # A house needs more frames than a room.
    eye_height_m: float = 1.45  # Where a person holds a scanner.
    depth_noise: float = 1.0  # Times the axial noise of a Kinect (Nguyen, Izadi and Lovell, 3DIMPVT 2012).
    drift_m: float = 0.004  # Standard deviation of the tracked position, wandering slowly: loops stay closed to a centimetre.
    drift_radians: float = 0.002  # The same for orientation: a tenth of a degree.
    voxel_m: float = 0.015  # Between ScanNet's 1 cm and the 2 cm of its decimated meshes.
    tilt_radians: float = 0.015  # The scan frame leans by about a degree: gravity from an accelerometer.
    unreadable_poses: int = 1  # Frames whose tracking was lost, written as -inf, as ScanNet has them.
    writes_alignment: bool = True  # Whether `axisAlignment` is in the text file.
    frames: Literal["folder", "sens", "none"] = "folder"  # Exported frames, a .sens container, or a mesh alone.
    has_long_aggregation_name: bool = False  # `<scan>_vh_clean.aggregation.json` instead of `<scan>.aggregation.json`.
    has_dataset_prefix: bool = False  # `scannet.` before the names inside the JSON files.
    jpeg_quality: int = 88  # Artifacts as a phone's own encoder leaves them.
