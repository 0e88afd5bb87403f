"""Reader of a plain folder of posed RGB-D frames: color, depth, poses and intrinsics, and no instances."""

from __future__ import annotations

from schemas.errors import InputError
from tasks.capture.documents import license_of
from tasks.capture.formats import Scan
from tasks.capture.frames import exported_frames
from tasks.capture.layout import frame_layout
from tasks.capture.reading import Reading


def read_posed_rgbd(scan: Scan) -> Reading:
    """The frames of a folder; its mesh is fused from them and its instances are found in that.

    Raises:
        InputError: the folder has no frames, no pose or no intrinsics, or a file of it is broken.
    """
    layout = frame_layout(scan.path)
    if layout is None or not layout.frames:
        raise InputError(scan.path.name, "folder", "holds no frames", "expected folders color and depth")
    if layout.trajectory is None and not any(frame.pose for frame in layout.frames):
        raise InputError(scan.path.name, "poses", "there are none", "add pose.txt with one camera-to-world pose a line, or a folder pose")
    frames, notes = exported_frames(layout, scan.path, {})
    if not any(frame.pose is not None for frame in frames):
        raise InputError(scan.path.name, "poses", f"none can be used ({'; '.join(notes)})", "write camera-to-world poses in metres")
    return Reading(
        surface=None,
        parts=(),
        groups=None,
        frames=frames,
        alignment=None,
        room_type="",
        license=license_of(scan.path),
        is_dense=True,
        degradations=tuple(notes),
    )
