"""The scan formats, which scans a folder holds, and which files each is read from. Opens nothing but
LICENSE.txt, and what says which scans are of one room."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from pathlib import Path

from schemas.errors import InputError
from schemas.families.scan_formats import SCAN_FORMATS
from schemas.files import stays_in
from tasks.capture.layout import folders_in
from tasks.capture.likeness import is_like, likeness
from tasks.capture.premises import stores
from tasks.capture.scan import Scan, ScanFormat, files_named, leaving, license_path
from tasks.families import member, members

FORMATS = members("tasks.capture", SCAN_FORMATS, ScanFormat)
"""Formats that are read, in the order in which they are looked for."""

EXAMPLE = next((format for format in FORMATS if format.is_plain), FORMATS[0])
"""What errors name where any format would do."""

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
        return dataclasses.replace(scan, scan=name).scene_id
    match = re.fullmatch(f"{pattern}(?P<storey>{STOREY})?", scan.scene_id) if pattern else None
    return match[1] + (match["storey"] or "") if match else scan.scene_id


def find_scans(
    folder: Path, format: str = "auto", dataset: str | None = None, links_into: Iterable[str | Path] = ()
) -> tuple[list[Scan], list[InputError]]:
    """Scans in `folder`, which is one scan or a folder of scans, sorted by scene id; and what is wrong with the rest.

    Hidden files, and plain files that are no scan, are passed over. A folder in which no scan is found or that cannot be
    read, and two scans that would be one scene, are errors; all other scans are still returned.

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
        return [], [_unreadable(folder, error)]
    if not exists:
        raise InputError(str(folder), "folder", "does not exist", "name a scan, or a folder of scans")
    folder = folder.resolve()
    root = (folder if folder.is_dir() else folder.parent, *allowed) if isinstance(folder, Path) else ()  # a listing has no links
    scan_list, errors = _search(folder, _Search(wanted, dataset, root), depth=0)
    by_scene: dict[str, list[Scan]] = {}
    for scan in _once(scan_list):
        if not _is_text(scan.path.as_posix()):
            shown = _below(scan.path, folder).encode("utf-8", "backslashreplace").decode()
            errors.append(InputError(shown, "name", "is no UTF-8", "rename the folder or file"))
            continue
        by_scene.setdefault(scan.scene_id, []).append(scan)
    scans = []
    for scene_id, same in sorted(by_scene.items()):
        if len(same) == 1:
            scans += same
            continue
        places = ", ".join(sorted(_below(scan.path, folder) for scan in same))
        errors.append(InputError(places, "scan", f"are all scene {scene_id}", "rename all but one, or give them different datasets"))
    return scans, errors


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


@dataclasses.dataclass(frozen=True)
class _Search:
    """What is looked for: formats; the dataset that is named; and where links may lead."""

    wanted: tuple[ScanFormat, ...]
    dataset: str | None
    places: tuple[Path, ...]

    def scan(self, format: ScanFormat, path: Path, scan: str) -> Scan:
        own = (path.resolve(),) if self.places and path.is_dir() else ()
        return Scan(format.name, path, self.dataset or format.dataset, scan, (*self.places, *own))

    def admits(self, path: Path) -> bool:
        return not path.is_symlink() or stays_in(path, *self.places)


def _search(folder: Path, search: _Search, depth: int) -> tuple[list[Scan], list[InputError]]:
    """What `_listed` finds; a folder that cannot be read, or a scan that cannot be one, is an error of its own."""
    try:
        return _listed(folder, search, depth)
    except OSError as error:
        return [], [_unreadable(folder, error)]
    except InputError as error:
        return [], [error]


def _unreadable(folder: Path, error: OSError) -> InputError:
    return InputError(folder.name, "folder", f"cannot be read ({error.strerror})", "check its permissions")


def _is_of_no_scan(error: InputError) -> bool:
    """Whether an error only says that a folder holds no scan, not that something in it is wrong."""
    return error.problem == _EMPTY or error.problem.startswith(_NO_SCAN)


_EMPTY, _NO_SCAN = "is empty", "holds no scan of a known format"


def _listed(folder: Path, search: _Search, depth: int) -> tuple[list[Scan], list[InputError]]:
    wanted = search.wanted
    if folder.is_file():
        for format in wanted:
            inside = format.within(folder.parent) if format.within is not None else ()
            for path, name in inside:
                if path == folder:
                    return [search.scan(format, folder, name)], []
            if folder.suffix.lower() in format.suffixes:
                return [search.scan(format, folder, folder.stem)], []
        return [], [InputError(folder.name, "file", "is no scan", f"expected {_expected(wanted)}")]
    if len(wanted) > 1 and is_like(folder, wanted):
        wanted = tuple(format for format in wanted if not format.is_last_resort)
        search = dataclasses.replace(search, wanted=wanted)
    single = _single(folder, search)
    if single is not None:
        return [single], []
    if depth and not search.admits(folder):
        return [], [leaving(folder)]
    parts = {path: (format, name) for format in wanted if format.within is not None for path, name in format.within(folder)}
    of_file = {path: (format, path.stem) for format in reversed(wanted) for path in files_named(folder, format.suffixes)}
    named = {path.stem for path in parts}  # what has the name of such a scan belongs to it: the model beside a captured room
    of_file = {path: own for path, own in of_file.items() if path.stem not in named} | parts
    files = [(format, path, name) for path, (format, name) in sorted(of_file.items())]  # the first format that reads it
    scans = [search.scan(format, path, name) for format, path, name in files if search.admits(path)]
    errors = [leaving(path) for _, path, _ in files if not search.admits(path)]
    for child in folders_in(folder) if depth < 2 else []:
        more, wrong = _search(child, search, depth + 1)
        scans, errors = scans + more, errors + [error for error in wrong if str(error) not in map(str, errors)]
    if not scans and not errors:
        is_empty = not any(folder.iterdir())
        errors.append(InputError(folder.name, "folder", _EMPTY, f"expected {_expected(wanted)}") if is_empty else _scanless(folder, wanted))
    elif not scans and all(map(_is_of_no_scan, errors)) and (depth or is_like(folder, wanted)):
        # A folder without a scan anywhere below it is one mistake, not one for each of its folders.
        errors = [_scanless(folder, wanted)]
    return scans, errors


def _single(folder: Path, search: _Search) -> Scan | None:
    """The scan that `folder` itself is, or None. Names decide, wherever links among them lead."""
    for format in search.wanted:
        name = format.recognize(folder)
        if name is not None and not (format.suffixes and any(map(_is_recorded, folders_in(folder)))):
            return search.scan(format, folder, name)
    return None


def _is_recorded(folder: Path) -> bool:
    """Whether a folder is or holds a recorded scan; then a file beside it is a scan of its own.

    So it is when the folder cannot be read: that is an error then, and not for a scan that would take it in.
    """
    try:
        return any(format.is_recorded(folder) for format in FORMATS)
    except (OSError, InputError):
        return True


def _names(wanted: tuple[ScanFormat, ...]) -> str:
    return ", ".join(format.name for format in wanted)


def _expected(wanted: tuple[ScanFormat, ...]) -> str:
    return wanted[0].expected if len(wanted) == 1 else f"one of the layouts of docs/formats.md, as {EXAMPLE.expected}"


def _scanless(folder: Path, wanted: tuple[ScanFormat, ...]) -> InputError:
    """What is said of a folder without a scan in it: what it looks like, and what to do."""
    problem = f"{_NO_SCAN} ({_names(wanted)})"
    like = likeness(folder, wanted)
    if like is None:
        return InputError(folder.name, "folder", problem, f"expected {_expected(wanted)}")
    return InputError(folder.name, "folder", f"{problem}; {like[0]}", like[1])


def _is_text(name: str) -> bool:
    """Whether a name can be kept in tables: one whose bytes are no UTF-8 cannot."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _below(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix() if path != folder else folder.name
