"""A plain folder of RGB-D frames: color, depth, intrinsics and usually poses, and no instances."""

from __future__ import annotations

from pathlib import Path

from schemas.errors import InputError
from tasks.capture.consistency.findings import settled
from tasks.capture.files.documents import license_of
from tasks.capture.files.frames import exported_frames, frame_statements
from tasks.capture.layout import folders_in, frame_layout, is_framed
from tasks.capture.premises import Premises
from tasks.capture.reading import Reading
from tasks.capture.scan import Scan, ScanFormat, license_path


def read_posed_rgbd(scan: Scan) -> Reading:
    """The frames of a folder; its mesh is fused from them and its instances are found in that. Where the folder has no poses, or none
    that can be used, frames are without.

    Raises:
        InputError: the folder has no frames or no intrinsics, or a file of it is broken.
    """
    layout = frame_layout(scan.path, scan.premises, above=True)
    if layout is None or not layout.frames:
        raise InputError(scan.path.name, "folder", "holds no frames", "expected folders color and depth")
    frames, notes = exported_frames(layout, scan.path, {})
    frames, findings = settled(frames, frame_statements(layout, scan.path, is_open=True))
    return Reading(
        surface=None,
        parts=(),
        groups=None,
        frames=frames,
        alignment=None,
        room_type="",
        license=license_of(license_path(scan.path, scan.premises)),
        is_dense=True,
        degradations=(*notes, *findings),
    )


def _files(scan: Scan, premises: Premises) -> list[Path]:
    layout = frame_layout(scan.folder, premises, above=True)
    return layout.files if layout is not None else []


POSED_RGBD = ScanFormat(
    name="posed_rgbd",
    dataset="rgbd",
    expected="folders color and depth with intrinsics, and with poses unless they are to be found",
    recognize=lambda folder: folder.name if is_framed(folder) else None,
    is_recorded=lambda folder: is_framed(folder) or any(map(is_framed, folders_in(folder))),
    files=_files,
    read=read_posed_rgbd,
    signs=("color/*", "depth/*", "pose*", "*intrinsic*"),
    is_plain=True,
    shared=True,
)
