"""What a folder that holds no scan looks like: the format that it has most of and what it lacks of that, or how others are converted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from tasks.capture.layout import STOREYS_RECORD, folders_in
from tasks.capture.scan import ScanFormat

MOST_NAMES = 2_000
"""Names that are looked at: a format shows in the first ones, and a folder may have millions."""

_POSED = "write folders color and depth (16-bit PNG in millimetres), pose.txt and intrinsics.json"

CONVERSIONS = {
    "*.zip": "unpack it",
    "*.tar*": "unpack it",
    "*.r3d": "rename it to .zip and unzip it, then it is a recording of Record3D",
    "*.bag": f"export the recording: {_POSED}",
    "*.mkv": f"export the recording: {_POSED}",
    "*.oni": f"export the recording: {_POSED}",
    "*.svo*": f"export the recording: {_POSED}",
    "*.db": f"export the recording: {_POSED}",
    "*.exr": f"depth as EXR is not read: {_POSED}",
    "*.np[yz]": f"arrays are not read: {_POSED}",
    "*.mp4": f"a video has no depth and no poses: {_POSED}",
    "*.mov": f"a video has no depth and no poses: {_POSED}",
    "*.e57": "points alone are not read: make a triangle mesh of them, in MeshLab or CloudCompare",
    "*.la[sz]": "points alone are not read: make a triangle mesh of them, in MeshLab or CloudCompare",
    "*.pcd": "points alone are not read: make a triangle mesh of them, in MeshLab or CloudCompare",
    "*.xyz": "points alone are not read: make a triangle mesh of them, in MeshLab or CloudCompare",
    "*.fbx": "export it as GLB, in Blender",
    "*.dae": "export it as GLB, in Blender",
    "*.gltf": "export it as GLB, in Blender",
    "*.blend": "export it as GLB, in Blender",
    "color/*": f"depth is missing: {_POSED}",
    "rgb/*": f"depth is missing: {_POSED}",
}
"""What to do with files that no format has, by their names; the first that is there counts."""


def likeness(folder: Path, formats: Sequence[ScanFormat]) -> tuple[str, str] | None:
    """What a folder looks like, and what to do: the format of which it has the largest share of signs, else what its files are; None
    where it looks like nothing.

    Raises:
        OSError: the folder cannot be read.
    """
    names = [name.lower() for name in _names(folder)]
    best = _most_like(names, formats)
    if best is not None:
        format, missing = best
        return f"looks like {format.name} without {', '.join(missing)}", f"{format.name} is {format.expected}"
    advice = next((advice for pattern, advice in CONVERSIONS.items() if any(fnmatchcase(name, pattern) for name in names)), None)
    return ("has files that no format has", advice) if advice is not None else None


def is_like(folder: Path, formats: Sequence[ScanFormat]) -> bool:
    """Whether a folder looks like a scan of a format that lacks something."""
    return _most_like([name.lower() for name in _names(folder)], formats) is not None


def _most_like(names: Sequence[str], formats: Sequence[ScanFormat]) -> tuple[ScanFormat, list[str]] | None:
    """The format of which names have the largest share of signs, the first of several, and the signs that they lack."""
    best: tuple[float, ScanFormat, list[str]] | None = None
    for format in formats:
        missing = [sign for sign in format.signs if not any(fnmatchcase(name, sign.lower()) for name in names)]
        share = 1.0 - len(missing) / len(format.signs) if format.signs else 0.0
        if missing and share > 0.0 and (best is None or share > best[0]):
            best = (share, format, missing)
    return None if best is None else best[1:]


def _names(folder: Path) -> Iterator[str]:
    """Names in a folder, and below the folders in it, as paths from it."""
    left = MOST_NAMES
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or path.name == STOREYS_RECORD:
            continue
        if path.is_file():
            yield path.name
            left -= 1
        if not left:
            return
    for place in folders_in(folder):
        try:
            inside = list(place.iterdir())
        except OSError:  # said of the folder itself, by who looks into it
            continue
        for path in (path for path in inside if path.name != STOREYS_RECORD):
            yield f"{place.name}/{path.name}"
            left -= 1
            if not left:
                return
