"""The scan formats, which scans a folder holds, and which files each is read from. Opens nothing but
LICENSE.txt, the first bytes of meshes, and what says which scans are of one room."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from pathlib import Path

from schemas.errors import InputError
from schemas.families.scan_formats import SCAN_FORMATS
from tasks.capture.premises import stores
from tasks.capture.scan import Scan, ScanFormat, UnusableScan, license_path
from tasks.capture.scene_ids import place_below, with_distinct_ids
from tasks.capture.search import Search, search, unreadable
from tasks.families import member, members

FORMATS = members("tasks.capture", SCAN_FORMATS, ScanFormat)
"""Formats that are read, in the order in which they are looked for."""

STOREY = r"_floor\d+"
"""How names of scans end that are storeys of another one."""


def format_of(scan: Scan) -> ScanFormat:
    """The format of a scan.

    Raises:
        InputError: there is no such format.
    """
    try:
        return member(FORMATS, scan.format)
    except KeyError as error:
        known = f"{', '.join(SCAN_FORMATS[:-1])} or {SCAN_FORMATS[-1]}"
        raise InputError(scan.path.name, "format", f"{scan.format!r} is not known", f"use {known}") from error


def room_of(scan: Scan) -> str:
    """Id of the physical room of a scan: rescans, where its format tells by names or files, are of one, and so is one storey in each of
    them; otherwise the scene's own. Two storeys are two rooms: nothing of one is in the other.

    Raises:
        InputError: the file that says so is broken.
    """
    stated, pattern = format_of(scan).room_stated, format_of(scan).room
    name = stated(scan) if stated is not None else None
    if name:
        return dataclasses.replace(scan, scan=name, word="").scene_id
    match = re.fullmatch(f"{pattern}(?P<storey>{STOREY})?", scan.scene_id) if pattern else None
    return match[1] + (match["storey"] or "") if match else scan.scene_id


def find_scans(
    folder: Path, format: str = "auto", dataset: str | None = None, links_into: Iterable[str | Path] = ()
) -> tuple[list[Scan], list[InputError]]:
    """Scans in `folder`, which is one scan or a folder of scans, sorted by scene id; and the errors of everything else.

    Each file whose ending a format reads becomes part of a scan, or is named in an error. A folder without a scan and one that
    cannot be read are a `UnusableScan`. Files that are passed over are a `PassedOver`: what this project wrote, archives, other
    files of a scan. Hidden files and files without such an ending are left out silently.

    `folder` and a scan's own folder may be links to anywhere. Any other link that leaves `folder` is left out and named,
    unless it leads into one of the folders `links_into`. Where two paths lead to one scan, it is found once.

    Raises:
        InputError: the format is not known, or `folder` or one of `links_into` does not exist.
    """
    if format not in ("auto", *SCAN_FORMATS):
        raise InputError("--format", "format", f"{format!r} is not known", f"use auto, {', '.join(SCAN_FORMATS)}")
    wanted = FORMATS if format == "auto" else (member(FORMATS, format),)
    allowed = stores(links_into)
    try:
        exists = folder.exists()
    except OSError as error:
        return [], [unreadable(folder, error)]
    if not exists:
        raise InputError(str(folder), "folder", "does not exist", "name a scan, or a folder of scans")
    folder = folder.resolve()
    root = (folder if folder.is_dir() else folder.parent, *allowed) if isinstance(folder, Path) else ()  # a listing has no links
    scan_list, errors = search(folder, Search(FORMATS, wanted, dataset, root))
    named = []
    for scan in _once(scan_list):
        if _is_text(scan.path.as_posix()):
            named.append(scan)
        else:
            shown = place_below(scan.path, folder).encode("utf-8", "backslashreplace").decode()
            errors.append(UnusableScan(InputError(shown, "name", "is no UTF-8", "rename the folder or file"), scan.path, scan.format))
    return with_distinct_ids(named, folder), errors


def _once(scans: Iterable[Scan]) -> list[Scan]:
    """Scans without those that are others by another path; the path without links counts, else the first."""
    unique: dict[tuple[str, Path], Scan] = {}
    for scan in scans:
        real = scan.path.resolve()
        if (scan.format, real) not in unique or scan.path == real:
            unique[scan.format, real] = scan
    return list(unique.values())


def scan_files(scan: Scan) -> list[Path]:
    """All files that the reader of the scan's format would read, sorted. Their content is what the scene depends on."""
    return survey(scan)[0]


def left_out(scan: Scan) -> str:
    """Links of a scan that leave the folder of scans, in a line; '' when there are none."""
    return survey(scan)[1]


def survey(scan: Scan) -> tuple[list[Path], str]:
    """What `scan_files` and `left_out` say, with one look."""
    folder, premises = scan.folder, scan.premises
    files = format_of(scan).files(scan, premises)
    license_file = license_path(folder, premises)
    if odd := [path.name for path in files if not _is_text(path.name)]:
        shown = odd[0].encode("utf-8", "backslashreplace").decode()
        raise InputError(f"{folder.name}/{shown}", "name", "is no UTF-8", "rename the file")
    return sorted({*files, *([license_file] if license_file else [])}), premises.note(folder)


def _is_text(name: str) -> bool:
    """Whether a name can be kept in tables: one whose bytes are no UTF-8 cannot."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True
