"""A scan looked at for storeys: read and leveled as capture does it, and divided where it has several."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
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
from tasks.capture.storeys.folder import is_of_one_lens, layout_of, write_storey
from tasks.capture.storeys.levels import Levels, stated_or_found
from tasks.capture.storeys.pieces import Storey, storeys_of
from tasks.geometry.transforms import translation

if TYPE_CHECKING:
    from tasks.capture.scenes import CaptureConfig

Array = NDArray[np.float64]

LENSES = "its frames have a lens each, which the folder of a storey cannot state"


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
        return self.reading.to_original


def divided(scan: Scan, config: CaptureConfig) -> Divided:
    """A scan by storeys, as capture with this config would level it.

    Raises:
        InputError: a file of the scan cannot be used, nothing is a storey's own, or there are only frames, and they have a lens each or
            none was taken in a storey.
    """
    reading, meanings, is_modelled = read_with_meanings(scan, label_map(config.label_map))
    reading, notes = with_poses(reading, config.poses, scan.path.name)
    surface = reading.surface
    if surface is None:
        surface, more = fused_surface(reading.frames, config.fusion, scan.path.name)
        notes = [*notes, *more]
    pose = aligned(reading, surface, meanings, config.votes, is_authored=is_modelled).pose
    parted = stated_or_found(reading.levels, pose, surface.transformed(pose), config.storeys)
    storeys = storeys_of(reading, meanings, pose, parted) if parted.cuts else ()
    lost = len(reading.frames) - sum(len(storey.reading.frames) for storey in storeys)
    if storeys and lost:
        notes = [*notes, f"{lost} of {len(reading.frames)} frames have no pose and are in no storey"]
    storeys, left_out = _writable(storeys, scan.path.name)
    return Divided(scan, reading, parted, pose, storeys, (*notes, *left_out))


def _writable(storeys: Sequence[Storey], name: str) -> tuple[tuple[Storey, ...], list[str]]:
    """What can be written of the storeys of a scan, and what had to be left out.

    Raises:
        InputError: nothing can of one of them.
    """
    kept, notes = [], []
    for storey in storeys:
        surface, frames = storey.reading.surface, storey.reading.frames
        where, remedy = f"storey {storey.number}", "or set capture.storeys.min_floor_m2 higher"
        if surface is None and not frames:
            raise InputError(name, "frames", f"no frame was taken in {where}, and there is no mesh", f"scan it from within, {remedy}")
        if surface is not None and not len(surface.faces):
            problem = f"{where} has none of its own: all that is there is of instances that are mostly in other storeys"
            raise InputError(name, "instances", problem, f"part them by storeys, {remedy}")
        if not is_of_one_lens(frames):
            if surface is None:
                raise InputError(name, "intrinsics", LENSES, "write one for all frames")
            storey = dataclasses.replace(storey, reading=dataclasses.replace(storey.reading, frames=()))
            notes.append(f"{where} is without its {len(frames)} frames: {LENSES}")
        kept.append(storey)
    return tuple(kept), notes


def write_divided(folder: Path, scan: Divided) -> None:
    """Write a scan of each storey into a folder.

    Raises:
        InputError: a frame cannot be read.
    """
    is_ply = scan.scan.path.suffix.lower() == ".ply" or (scan.scan.path.is_dir() and any(scan.scan.path.glob("*.ply")))
    layout = layout_of([storey.reading for storey in scan.storeys], is_ply)
    for storey in scan.storeys:
        write_storey(folder / scan.name(storey), storey.reading, scan.scan.folder, layout, scan.to_level(storey))
