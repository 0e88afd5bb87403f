"""Copies of scans that broke off, and scans whose ids the lake has in other letters."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from flows.run.fingerprints import FileHashes
from flows.run.identity import nameless_path
from schemas.errors import InputError
from schemas.files import open_file
from tasks.capture.formats import scan_files
from tasks.capture.premises import place_of
from tasks.capture.scan import Scan, UnusableScan
from tasks.capture.scene_ids import marked_scan
from warehouse.tables.snapshot import Reader

_CHUNK_BYTES = 2**20

_COPY_ENDING = re.compile(
    r"[ _.-]*(?:\(\d+\)|\((?:another |\d+(?:st|nd|rd|th) )?copy(?: \d+)?\)|~"
    r"|(?<=[ _.-])(?:copy|kopie|copie|backup|bak|old|orig)(?:[ _-]?\d+)?)$",
    re.IGNORECASE | re.ASCII,
)
"""Endings that file managers and people give to copies: `scan (copy)`, `scan (1)`, `scan - Copy`, `scan.bak`."""

_COPY_BEGINNING = re.compile(r"^(?:copy of|kopie von) ", re.IGNORECASE)


@dataclasses.dataclass(frozen=True)
class _Files:
    """A scan's files by their paths without its name, and their sizes [B]."""

    scan: Scan
    paths: Mapping[str, Path]
    sizes: Mapping[str, int]


def incomplete_copies(scans: Sequence[Scan], hashes: FileHashes) -> dict[str, UnusableScan]:
    """Scans that are copies of another one and hold only a part of it, by scene id.

    Such a copy has no other files than the scan that it is named after. Each of them is equal, or ends early.
    """
    groups: dict[tuple[str, str], list[Scan]] = {}
    for scan in scans:
        groups.setdefault((scan.format, _original(scan)), []).append(scan)
    incomplete = {}
    for group in groups.values():
        known = [_files_of(scan) for scan in group] if len(group) > 1 else []
        for copy in known:
            whole = next((other for other in known if other is not copy and _is_part(copy, other, hashes)), None)
            if whole is not None:
                name = copy.scan.path.name
                error = InputError(name, "files", f"are an incomplete copy of {whole.scan.scene_id}", "delete them, or copy them again")
                incomplete[copy.scan.scene_id] = UnusableScan(error, copy.scan.path, copy.scan.format)
    return incomplete


def apart_from_lake(scans: Sequence[Scan], reader: Reader) -> list[Scan]:
    """Scans with digits in the ids that the lake has in other upper and lower case, which some file systems do not tell apart."""
    if not scans or not reader.files("scenes"):
        return list(scans)
    known = set(reader.matching("scenes", {}, ["scene_id"]).column("scene_id").to_pylist())
    taken = {scene.casefold(): scene for scene in known}
    apart = []
    for scan in scans:
        other = taken.get(scan.scene_id.casefold(), scan.scene_id)
        apart.append(scan if other == scan.scene_id or scan.scene_id in known else marked_scan(scan, scan.path.name, ()))
    return sorted(apart, key=lambda scan: scan.scene_id)


def _original(scan: Scan) -> str:
    """The name of the scan that a name is a copy's of."""
    name = _COPY_BEGINNING.sub("", scan.scan)
    while (shorter := _COPY_ENDING.sub("", name)) not in ("", name):
        name = shorter
    return name.casefold()


def _files_of(scan: Scan) -> _Files:
    places = {place_of(path, scan.folder): path for path in scan_files(scan)}
    paths = places if scan.path.is_dir() else {nameless_path(place, scan): path for place, path in places.items()}
    return _Files(scan, paths, {name: path.stat().st_size for name, path in paths.items()})


def _is_part(copy: _Files, whole: _Files, hashes: FileHashes) -> bool:
    if not copy.paths.keys() <= whole.paths.keys() or not any(copy.sizes.values()):
        return False
    shorter = [name for name, size in copy.sizes.items() if size != whole.sizes[name]]
    if any(copy.sizes[name] > whole.sizes[name] for name in shorter):
        return False
    if not shorter and len(copy.paths) == len(whole.paths):
        return False
    same = [name for name in copy.paths if name not in shorter]
    if not all(_begins_with(whole.paths[name], copy.paths[name]) for name in shorter):
        return False
    return all(_hash(copy, name, hashes) == _hash(whole, name, hashes) for name in same)


def _begins_with(path: Path, start: Path) -> bool:
    """True if a file begins with the content of another one."""
    with open_file(path, path.name, 2**62) as longer, open_file(start, start.name, 2**62) as shorter:
        while chunk := shorter.read(_CHUNK_BYTES):
            if longer.read(len(chunk)) != chunk:
                return False
    return True


def _hash(files: _Files, name: str, hashes: FileHashes) -> str:
    return str(next(iter(hashes.entries(files.scan.folder, [files.paths[name]])))[1])
