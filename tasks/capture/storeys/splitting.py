"""A scan looked at for storeys: read and leveled as capture does it, and divided where it has several."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.fusion import fused_surface
from tasks.capture.labels import label_map
from tasks.capture.leveling import aligned, read_with_meanings
from tasks.capture.poses.provider import with_poses
from tasks.capture.reading import Reading
from tasks.capture.scan import Scan
from tasks.capture.storeys.folder import write_storey
from tasks.capture.storeys.levels import Levels, levels
from tasks.capture.storeys.pieces import Storey, storeys_of
from tasks.geometry.transforms import translation

if TYPE_CHECKING:
    from tasks.capture.scenes import CaptureConfig

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Divided:
    """A scan by storeys. levels: In the leveled frame. pose: Scan frame to the leveled frame, 4x4 [m]. storeys: What each has, none where
    the scan has one storey."""

    scan: Scan
    reading: Reading
    levels: Levels
    pose: Array
    storeys: tuple[Storey, ...]
    notes: tuple[str, ...]

    def name(self, storey: Storey) -> str:
        """What the scan of a storey is called."""
        return f"{self.scan.scan}_floor{storey.number}"

    def to_level(self, storey: Storey) -> Array:
        """Scan frame to a frame with the storey's floor at z = 0, 4x4 [m]; all of a scan have the same axes."""
        return translation([0.0, 0.0, -storey.floor]) @ self.pose

    @property
    def to_original(self) -> Array:
        """What brings the scans of storeys, as they are read, back to the coordinates of the scan's file, 4x4."""
        change = self.reading.from_file
        return np.eye(4) if change is None else np.asarray(np.linalg.inv(change), dtype=np.float64)


def divided(scan: Scan, config: CaptureConfig) -> Divided:
    """A scan by storeys, as capture with this config would level it.

    Raises:
        InputError: a file of the scan cannot be used, or no frame was taken in a storey of which there are only frames.
    """
    reading, meanings, is_modelled = read_with_meanings(scan, label_map(config.label_map))
    reading, notes = with_poses(reading, config.poses, scan.path.name)
    surface = reading.surface
    if surface is None:
        surface, more = fused_surface(reading.frames, config.fusion, scan.path.name)
        notes = [*notes, *more]
    pose = aligned(reading, surface, meanings, config.votes, is_authored=is_modelled).pose
    parted = levels(surface.transformed(pose), config.storeys)
    storeys = storeys_of(reading, meanings, pose, parted) if parted.cuts else ()
    for storey in storeys:
        if storey.reading.surface is None and not storey.reading.frames:
            problem = f"no frame was taken in storey {storey.number}, and there is no mesh"
            raise InputError(scan.path.name, "frames", problem, "scan it from within, or set capture.storeys.min_floor_m2 higher")
    lost = len(reading.frames) - sum(len(storey.reading.frames) for storey in storeys)
    if storeys and lost:
        notes = [*notes, f"{lost} of {len(reading.frames)} frames have no pose and are in no storey"]
    return Divided(scan, reading, parted, pose, storeys, tuple(notes))


def write_divided(folder: Path, scan: Divided) -> list[str]:
    """Write a scan of each storey into a folder, and say what had to be left out.

    Raises:
        InputError: a frame cannot be read.
    """
    notes: list[str] = []
    is_ply = scan.scan.path.suffix.lower() == ".ply" or (scan.scan.path.is_dir() and any(scan.scan.path.glob("*.ply")))
    for storey in scan.storeys:
        notes += write_storey(folder / scan.name(storey), storey.reading, scan.scan.folder, is_ply, scan.to_level(storey))
    return list(dict.fromkeys(notes))
