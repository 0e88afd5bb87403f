"""What a folder that holds no scan looks like: the format that it has most of and what it lacks of that, or how others are converted."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from schemas.errors import InputError
from tasks.capture.layout import STOREYS_RECORD, folders_in, has_key_frames, is_frame_name, leads_up
from tasks.capture.products import product_of
from tasks.capture.scan import ScanFormat, matches

MAX_DEPTH_BELOW = 4
"""Folders below a scan or below the search in which scans and meshes are still named."""

MOST_NAMES = 2_000
"""Names that are looked at: a format shows in the first ones, and a folder may have millions."""

_POSED = "write folders color and depth (16-bit PNG in millimetres), pose.txt and intrinsics.json"

DOWNLOADING = "it is not whole: wait for the download, or download it again"

CONVERSIONS = {
    "*.zip": "unpack it",
    "*.tar*": "unpack it",
    "*.tgz": "unpack it",
    "*.7z": "unpack it",
    "*.rar": "unpack it",
    "*.part": DOWNLOADING,
    "*.partial": DOWNLOADING,
    "*.download": DOWNLOADING,
    "*.crdownload": DOWNLOADING,
    "*.bag": f"export the recording: {_POSED}",
    "*.mkv": f"export the recording: {_POSED}",
    "*.oni": f"export the recording: {_POSED}",
    "*.svo*": f"export the recording: {_POSED}",
    "*.db": f"export the recording: {_POSED}",
    "*.exr": f"depth as EXR is not read: {_POSED}",
    "*.np[yz]": f"arrays are not read: {_POSED}",
    "*.mp4": f"a video has no depth and no poses: {_POSED}",
    "*.mov": f"a video has no depth and no poses: {_POSED}",
    "*.fbx": "export it as GLB, in Blender",
    "*.dae": "export it as GLB, in Blender",
    "*.gltf": "export it as GLB, in Blender",
    "*.blend": "export it as GLB, in Blender",
    "*.stl": "export it as GLB, in Blender",
    "*.usd[ac]": "package it as USDZ (usdzip of OpenUSD), or export it as GLB, in Blender",
    "*.usd": "package it as USDZ (usdzip of OpenUSD), or export it as GLB, in Blender",
    "color/*": f"depth is missing: {_POSED}",
    "rgb/*": f"depth is missing: {_POSED}",
}
"""What to do with files that no format has, by their names; the first that is there counts."""


_PARTS = ("*.np[yz]", "*.exr", "*.mp4", "*.mov", "color/*", "rgb/*")
"""Patterns of files that belong to something else as often as they are scans by themselves."""

IMAGES = (".jpg", ".jpeg", ".png", ".webp", ".tga", ".bmp", ".tif", ".tiff", ".exr", ".hdr", ".ktx2", ".dds")
"""Endings of textures."""

MATERIALS = frozenset((*IMAGES, ".mtl", ".txt", ".bin"))
"""Endings of textures and of their lists; frames have no others."""

_JUNK = frozenset({
    "thumbs.db", "desktop.ini", "icon\r", "__macosx", "lost+found", "system volume information", "$recycle.bin", "@eadir",
})  # fmt: skip
"""Files and folders that operating systems leave, in addition to hidden files."""


def likeness(folder: Path, formats: Sequence[ScanFormat]) -> tuple[str, str] | None:
    """What a folder looks like, and what to do: the format of which it has the largest share of signs, else what its files are; None
    where it looks like nothing.

    Raises:
        OSError: the folder cannot be read.
    """
    if has_key_frames(folder):
        return "has key frames of Polycam, which are not read", "the mesh of the same scan is read: raw.glb, or an export as GLB"
    names = [name.lower() for name in _names(folder)]
    best = _most_like(names, formats)
    if best is not None:
        format, missing = best
        return f"looks like {format.name} without {', '.join(missing)}", f"{format.name} is {format.expected}"
    advice = next((advice for pattern, advice in CONVERSIONS.items() if any(fnmatchcase(name, pattern) for name in names)), None)
    return ("has files that no format has", advice) if advice is not None else None


def telling_format(folder: Path, formats: Sequence[ScanFormat]) -> ScanFormat | None:
    """The format whose scan a folder is without something: names in it are a format's own, not ones that any folder may have."""
    names = [name.lower() for name in _names(folder)]
    best = _most_like(names, formats, _is_telling)
    return None if best is None else best[0]


def convertible(folder: Path) -> dict[str, list[str]]:
    """Names of files directly in a folder that would be scans if they were converted, by what to do with them."""
    advised: dict[str, list[str]] = {}
    for path in visible(folder):
        pattern = next((pattern for pattern in CONVERSIONS if fnmatchcase(path.name.lower(), pattern)), None)
        if pattern is not None and pattern not in _PARTS and not path.is_dir():
            advised.setdefault(CONVERSIONS[pattern], []).append(path.name)
    return advised


def is_material(folder: Path) -> bool:
    """True if a folder holds textures and their lists, and nothing else."""
    paths = list(visible(folder))
    return bool(paths) and all(path.suffix.lower() in MATERIALS for path in paths)


def enclosed_scans(
    folder: Path, formats: Sequence[ScanFormat], admits: Callable[[Path], bool], is_passed: Callable[[Path], bool] = lambda place: False
) -> list[str]:
    """Recorded scans below a folder: their paths from it, and the formats that they have. Nothing below them is named.

    admits: False for links that are not followed. is_passed: True for folders that are left out with all that lies in them.
    """
    enclosed: list[str] = []
    level = scan_folders(folder, admits)
    for _ in range(MAX_DEPTH_BELOW):
        inner: list[Path] = []
        for place in level:
            if is_passed(place):
                continue
            if name := recorded_format(place, formats):
                enclosed.append(f"{place.relative_to(folder).as_posix()} ({name})")
            else:
                inner += scan_folders(place, admits)
        level = inner
    return enclosed


def scan_folders(folder: Path, admits: Callable[[Path], bool]) -> list[Path]:
    """Folders in a folder that may be scans: neither products of this project, nor images alone."""
    places = []
    with contextlib.suppress(OSError):  # the search says so
        for path in visible(folder):
            if path.is_dir() and admits(path) and not leads_up(path) and _may_be_scan(path) and not product_of(path):
                places.append(path)
    return places


def recorded_format(folder: Path, formats: Sequence[ScanFormat]) -> str:
    """Name of the format whose recorded scan a folder is, or that has scans in it; '' for none."""
    for format in (format for format in formats if not format.suffixes):
        try:
            if format.recognize(folder) is not None or (format.within is not None and format.within(folder)):
                return format.name
        except InputError:  # it looks like one
            return format.name
        except OSError:
            return ""
    return ""


def _may_be_scan(folder: Path) -> bool:
    """True unless a folder holds images and texts alone that are not frames: asking each format about thousands takes long."""
    return any(path.suffix.lower() not in MATERIALS or is_frame_name(path.name) for path in folder.iterdir())


def visible(folder: Path) -> Iterator[Path]:
    """Entries of a folder, sorted, without hidden files and leftovers of operating systems."""
    return (path for path in sorted(folder.iterdir()) if not path.name.startswith(".") and not is_junk(path.name))


def is_junk(name: str) -> bool:
    """True if an operating system or browser left a file of this name. A colon begins a stream of a file, as `:Zone.Identifier`."""
    return name.lower() in _JUNK or name.lower().endswith((":zone.identifier", ".zone.identifier"))


def _is_telling(sign: str) -> bool:
    """True if a sign has more of a name than an ending or the name of a folder."""
    folder, _, name = sign.rpartition("/")
    stem, dot, _ = name.rpartition(".")
    return bool(dot) and (bool(stem.strip("*")) or bool(folder))


def _is_evidence(sign: str) -> bool:
    """True if a sign is more than an ending, which files of any kind have."""
    return not sign.startswith("*.") or sign.count(".") > 1


def _most_like(
    names: Sequence[str], formats: Sequence[ScanFormat], is_evidence: Callable[[str], bool] = _is_evidence
) -> tuple[ScanFormat, list[str]] | None:
    """The format of which names have the largest share of signs, the first of several, and the signs that they lack."""
    best: tuple[float, ScanFormat, list[str]] | None = None
    for format in formats:
        present = [sign for sign in format.signs if any(matches(name, [sign.lower()]) for name in names)]
        missing = [sign for sign in format.signs if sign not in present]
        share = len(present) / len(format.signs) if any(map(is_evidence, present)) else 0.0
        if missing and share > 0.0 and (best is None or share > best[0]):
            best = (share, format, missing)
    return None if best is None else best[1:]


def _names(folder: Path) -> Iterator[str]:
    """Names in a folder, and below the folders in it, as paths from it."""
    left = MOST_NAMES
    for path in visible(folder):
        if path.name == STOREYS_RECORD:
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
