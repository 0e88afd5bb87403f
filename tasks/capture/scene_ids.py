"""Scene ids of scans that lie together: no two are the same, also where file systems do not tell `A` from `a`."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable
from pathlib import Path

from tasks.capture.scan import Scan
from tasks.words import marked_word, plain_word


def with_distinct_ids(scans: Iterable[Scan], folder: Path) -> list[Scan]:
    """Scans with ids that differ in more than upper and lower case, sorted by id.

    A scan whose id no other one has keeps it, whatever else lies there. Of several with one id, the one with the plainest name and
    the shortest path keeps it; ids of the others end in digits of their paths.

    Args:
        scans: scans that were found, each once.
        folder: the folder that they were found in.
    """
    groups: dict[str, list[Scan]] = {}
    for scan in scans:
        groups.setdefault(scan.scene_id.casefold(), []).append(scan)
    distinct, colliding = [], []
    for group in groups.values():
        first, *rest = sorted(group, key=lambda scan: _rank(scan, folder))
        distinct.append(first)
        colliding += rest
    taken = {scan.scene_id.casefold() for scan in distinct}
    for scan in sorted(colliding, key=lambda scan: _rank(scan, folder)):
        marked = marked_scan(scan, place_below(scan.path, folder), taken)
        taken.add(marked.scene_id.casefold())
        distinct.append(marked)
    return sorted(distinct, key=lambda scan: scan.scene_id)


def marked_scan(scan: Scan, identity: str, taken: Collection[str]) -> Scan:
    """A scan with digits of a text in its id. `taken`: ids in lower case that it must not have."""
    marked = dataclasses.replace(scan, word=marked_word(scan.scan, identity))
    while marked.scene_id.casefold() in taken:
        identity += "\0"  # somebody named a folder as such an id
        marked = dataclasses.replace(scan, word=marked_word(scan.scan, identity))
    return marked


def place_below(path: Path, folder: Path) -> str:
    """A path as one from a folder that it lies in; the folder's own name for the folder itself."""
    return path.relative_to(folder).as_posix() if path != folder else folder.name


def _rank(scan: Scan, folder: Path) -> tuple[bool, bool, int, str]:
    place = place_below(scan.path, folder)
    is_copy = scan.scan not in (scan.path.name, scan.path.stem)  # its files say another name than its folder
    return plain_word(scan.scan) != scan.scan, is_copy, len(place), place
