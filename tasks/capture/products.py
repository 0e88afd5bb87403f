"""Recognition of folders and files that this project wrote: lakes, releases, exports and their meshes. They are never scans."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection
from pathlib import Path

from schemas.errors import InputError
from schemas.files import open_file

EXPORT_MARK = ".exported"
"""File in every folder that `metascenes export` wrote."""

_HASHED = re.compile(r"(?:.+_(?P<object>[0-9a-f]{16})(?:\.collider)?|(?P<blob>[0-9a-f]{64}))\.glb")
"""Names of objects of a Habitat dataset and of blobs of a lake, which end with the hash of their content."""

_BODIES = re.compile(r"(.+_[0-9a-f]{8}|room_[a-z]+(_\d+)?)_(part|hull)_\d{2,}\.obj")
"""Names of bodies of MJCF, URDF and SDF."""

_NUMBER = rb"-?\d+(?:\.\d+(?:e-?\d+)?|e-?\d+)"

_BODY = re.compile(rb"(mtllib [^\n]+\nusemtl look\n)?(v( %b){3}\n)+(vt( %b){2}\n)*(f( [\d/]+){3}\n)*" % (_NUMBER, _NUMBER))
"""Form of these bodies: no comments, no names, and a fraction in every number."""

_EXPORTS = (
    {"metascenes.scene_dataset_config.json"},
    {"scene.usda", "room", "assets"},
    {"room.urdf", "poses.json"},
    {"map.pgm", "map.yaml", "objects.json"},
)
"""Names in exported scenes, which a copy has without the mark of the folder that they lay in."""

_DATASET = ".scene_dataset_config.json"

_MODELS = {"scene.xml", "world.sdf"}
"""Files of exported scenes that models by others have, too: the meshes next to them decide."""

_HEAD_BYTES = 65_536
"""The mark stands within the first lines of a GLB and of a layer; the rest may be gigabytes."""

_WRITER = b'"generator":"https://github.com/mikedh/trimesh"'
"""Generator of blobs, which many others write, too."""

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
    if EXPORT_MARK in names or any(own <= names for own in _EXPORTS) or _is_dataset(folder, names):
        return "an export"
    for parts in (folder / "assets", folder / "meshes") if names & _MODELS else ():
        meshes = [path.name for path in parts.iterdir() if path.suffix == ".obj"] if parts.is_dir() else []
        if meshes and all(map(_BODIES.fullmatch, meshes)):
            return "an export"
    return ""


def is_product(path: Path) -> bool:
    """True if this project wrote a mesh file: its content or the dataset that it lies in says so, never its name alone.

    In a listing, content is unknown.
    """
    if (path.parent / f"{path.stem}.stage_config.json").is_file() and any(map(_is_dataset, (path.parent, path.parent.parent))):
        return True
    ending = path.suffix.lower()
    is_candidate = ending in (".glb", ".usdz") or _BODIES.fullmatch(path.name) is not None
    if not is_candidate or not isinstance(path, Path):
        return False
    try:
        with open_file(path, path.name, 2**62) as file:
            head = file.read(_HEAD_BYTES)
            if ending == ".obj":
                return _BODY.fullmatch(head[: head.rfind(b"\n") + 1]) is not None
            if _MARKS.search(head) is not None:
                return True
            named = _HASHED.fullmatch(path.name)
            if named is None or (named["blob"] and _WRITER not in head):
                return False
            file.seek(0)
            return hashlib.file_digest(file, "sha256").hexdigest().startswith(named["blob"] or named["object"])
    except (OSError, InputError):  # its reader says so
        return False


def _is_dataset(folder: Path, names: Collection[str] | None = None) -> bool:
    """True if a folder is the root of a Habitat dataset of this project, under any name: others have no such lexicon and table."""
    try:
        names = {path.name for path in folder.iterdir()} if names is None else names
    except OSError:  # the search says so
        return False
    datasets = [name.removesuffix(_DATASET) for name in names if name.endswith(_DATASET)]
    return any((folder / "semantics" / f"{name}_lexicon.json").is_file() for name in datasets) and (
        (folder / "metadata" / "attribution.csv").is_file()
    )
