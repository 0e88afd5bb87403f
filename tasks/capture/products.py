"""Recognition of folders and files that this project wrote: lakes, releases, exports and their meshes. They are never scans."""

from __future__ import annotations

import re
from pathlib import Path

from schemas.errors import InputError
from schemas.files import open_file

EXPORT_MARK = ".exported"
"""File in every folder that `metascenes export` wrote."""

_MESHES = re.compile(
    r".+_[0-9a-f]{16}(\.collider)?\.glb"  # objects of a Habitat dataset
    r"|[0-9a-f]{64}\.\w+"  # blobs of a lake
    r"|(.+_[0-9a-f]{8}|room_[a-z]+(_\d+)?)_(part|hull)_\d{2,}\.(obj|glb|ply)"  # bodies of MJCF, URDF and SDF
)

_EXPORTS = (
    {"metascenes.scene_dataset_config.json"},
    {"scene.usda", "room", "assets"},
    {"room.urdf", "poses.json"},
    {"map.pgm", "map.yaml", "objects.json"},
)
"""Names in exported scenes, which a copy has without the mark of the folder that they lay in."""

_MODELS = {"scene.xml", "world.sdf"}
"""Files of exported scenes that models by others have, too: the meshes next to them decide."""

_HEAD_BYTES = 65_536
"""The mark stands within the first lines of a GLB and of a layer; the rest may be gigabytes."""

_MARKS = re.compile(rb'"generator"\s*:\s*"metascenes"|dictionary metascenes\b')
"""Text in every GLB scene and in the first layer of every USD package."""


def product_of(folder: Path) -> str:
    """The kind of a folder that this project wrote: `a lake`, `a release` or `an export`; '' for any other.

    Raises:
        OSError: the folder cannot be read.
    """
    names = {path.name for path in folder.iterdir()}
    if "lake.json" in names and names & {"tables", "blobs", "staged", "releases", "tmp"}:
        return "a lake"
    if {"release.json", "SHA256SUMS"} <= names:
        return "a release"
    if EXPORT_MARK in names or any(own <= names for own in _EXPORTS):
        return "an export"
    for parts in (folder / "assets", folder / "meshes") if names & _MODELS else ():
        meshes = [path.name for path in parts.iterdir() if path.suffix == ".obj"] if parts.is_dir() else []
        if meshes and all(map(_MESHES.fullmatch, meshes)):
            return "an export"
    return ""


def is_product(path: Path) -> bool:
    """True if this project wrote a mesh file, by its name, the names next to it, and the mark in it. In a listing names decide."""
    if _MESHES.fullmatch(path.name) or (path.parent / f"{path.stem}.stage_config.json").is_file():
        return True
    if path.suffix.lower() not in (".glb", ".usdz") or not isinstance(path, Path):
        return False
    try:
        with open_file(path, path.name, 2**62) as file:
            head = file.read(_HEAD_BYTES)
    except (OSError, InputError):  # its reader says so
        return False
    return _MARKS.search(head) is not None
