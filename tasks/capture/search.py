"""The search for scans in a folder: each file that a format reads becomes part of a scan, or is named with the reason."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path

from schemas.errors import InputError
from schemas.files import stays_in
from schemas.wording import counted
from tasks.capture.layout import folders_in, is_framed
from tasks.capture.likeness import (
    IMAGES,
    MAX_DEPTH_BELOW,
    convertible,
    enclosed_scans,
    is_junk,
    is_material,
    likeness,
    recorded_format,
    scan_folders,
    telling_format,
    visible,
)
from tasks.capture.products import is_product, product_of
from tasks.capture.scan import PassedOver, Scan, ScanFormat, UnusableScan, files_named, leaving, matches

MAX_DEPTH = 2
"""Folders in folders that are searched for scans; collections have none deeper."""

MAX_NAMES_BELOW = 20_000
"""Names that are looked at below a folder: frames may be millions, and meshes are few."""

MAX_NAMED = 3
"""Files that a line names; it counts the others."""

MAX_FOLDERS_NAMED = 12
"""Folders that a line names: a demo has eight next to its scans."""

_FRAME_ENDINGS = frozenset((*IMAGES, ".txt", ".json", ".depth", ".conf", ".pgm", ".ppm", ".pincam", ".csv", ".ply", ".obj", ".mtl", ".bin"))
"""Endings of files that stand in folders by the thousand, and that folders do not have: these are not asked whether they are one."""

Found = tuple[list[Scan], list[InputError]]


@dataclasses.dataclass(frozen=True)
class Search:
    """Scope of a search: the wanted ones of all formats; the dataset, if it is named; and where links may lead."""

    formats: tuple[ScanFormat, ...]
    wanted: tuple[ScanFormat, ...]
    dataset: str | None
    places: tuple[Path, ...]

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Endings of files that are scans by themselves."""
        return tuple({suffix for format in self.wanted for suffix in format.suffixes})

    @property
    def expected(self) -> str:
        """Description of a scan for an error."""
        if len(self.wanted) == 1:
            return self.wanted[0].expected
        example = next((format for format in self.formats if format.is_plain), self.formats[0])
        return f"one of the layouts of docs/formats.md, as {example.expected}"

    def scan(self, format: ScanFormat, path: Path, name: str) -> Scan:
        """A scan that was found."""
        own = (path.resolve(),) if self.places and path.is_dir() else ()
        return Scan(format.name, path, self.dataset or format.dataset, name, (*self.places, *own))

    def admits(self, path: Path) -> bool:
        """True if a path is not a link that leaves the places."""
        return not path.is_symlink() or stays_in(path, *self.places)

    def format_of(self, path: Path) -> ScanFormat | None:
        """The first format that reads a file by itself."""
        return next((format for format in self.wanted if path.suffix.lower() in format.suffixes), None)


def search(folder: Path, wanted: Search, depth: int = 0) -> Found:
    """Scans in a folder, and an error for everything else that may be one; a folder that cannot be read is an error of its own."""
    try:
        scans, errors = _of_file(folder, wanted) if folder.is_file() else _of_folder(folder, wanted, depth)
    except OSError as error:
        return [], [unreadable(folder, error)]
    except InputError as error:
        return [], [error if isinstance(error, UnusableScan | PassedOver) else UnusableScan(error, folder)]
    if depth == 0 and not scans and all(isinstance(error, PassedOver) for error in errors):
        errors.append(_scanless(folder, wanted))
    return scans, errors


def unreadable(folder: Path, error: OSError) -> UnusableScan:
    """The error of a folder that cannot be read."""
    return UnusableScan(InputError(folder.name, "folder", f"cannot be read ({error.strerror})", "check its permissions"), folder)


def _of_file(path: Path, wanted: Search) -> Found:
    for format in wanted.wanted:
        # A listing of one object has no folder above it.
        inner = format.within(path.parent) if format.within is not None and path.parent.is_dir() else ()
        for inside, name in inner:
            if inside == path:
                return [wanted.scan(format, path, name)], []
    own = wanted.format_of(path)
    if own is None:
        return [], [UnusableScan(InputError(path.name, "file", "is no scan", f"expected {wanted.expected}"), path)]
    if wanted.admits(path) and is_product(path):
        return [], [UnusableScan(InputError(path.name, "file", "was written by metascenes and is not a scan", _OTHER), path)]
    return [wanted.scan(own, path, path.stem)], []


_OTHER = "name the scan that it was made from"


def _of_folder(folder: Path, wanted: Search, depth: int) -> Found:
    if depth == 0 and (product := product_of(folder)):
        return [], [UnusableScan(InputError(folder.name, "folder", f"is {product} of metascenes and not a scan", _OTHER), folder)]
    recorded = _recorded(folder, wanted)
    if recorded is not None:
        format = _format(recorded, wanted)
        unread, inner = _unread(folder, recorded, wanted), _inner(folder, recorded, wanted)
        # Of formats that are recordings, the folder itself is the scan, whatever lies in it.
        if format.within is None or not format.is_modelled or not (unread or inner):
            return [recorded], _not_read(folder, recorded, unread, inner)
    if depth and not wanted.admits(folder):
        return [], [UnusableScan(leaving(folder), folder)]
    parts = {path: (format, name) for format in wanted.wanted if format.within is not None for path, name in format.within(folder)}
    meshes = [path for path in files_named(folder, wanted.suffixes) if path not in parts and not is_junk(path.name)]
    models = _models(meshes, [path for path, (format, _) in parts.items() if format.is_modelled])
    meshes = [path for path in meshes if path not in models]
    written = [path for path in meshes if wanted.admits(path) and is_product(path)]
    meshes = sorted({*meshes} - {*written})
    incomplete = telling_format(folder, wanted.wanted) if len(wanted.wanted) > 1 else None
    withheld = [path for path in meshes if incomplete is not None and getattr(wanted.format_of(path), "is_last_resort", False)]
    meshes = sorted({*meshes} - {*withheld})
    below, errors = _below(folder, wanted, depth, [*meshes, *parts])
    alone = meshes[0] if len(meshes) == 1 and not parts and not below and not withheld and not written else None
    is_folder_of_one = alone is not None and not any(isinstance(error, UnusableScan) and not _is_of_no_scan(error) for error in errors)
    if is_folder_of_one and alone is not None:
        own = wanted.format_of(alone)
        scans = [wanted.scan(own, folder, folder.name)] if own is not None else []
    else:
        files = {path: (own, path.stem) for path in meshes if (own := wanted.format_of(path)) is not None} | parts
        scans = [wanted.scan(format, path, name) for path, (format, name) in sorted(files.items()) if wanted.admits(path)]
        errors = [UnusableScan(leaving(path), path) for path in sorted(files) if not wanted.admits(path)] + errors
    scans += below
    if written:
        errors.append(_written_line(folder, f"{_listed(written, folder)}"))
    if withheld and (scans or len(errors)):
        errors.append(_scanless(folder, wanted, withheld, depth))
    if scans:
        errors += [PassedOver(_listed([folder / name for name in names], folder), "", "not a scan", advice)
                   for advice, names in convertible(folder).items()]  # fmt: skip
        errors += _same_names(scans)
    return _in_short(folder, wanted, depth, scans, errors, withheld)


def _in_short(folder: Path, wanted: Search, depth: int, scans: list[Scan], errors: list[InputError], withheld: Sequence[Path]) -> Found:
    """A folder without a scan anywhere below it as one mistake, not one for each of its folders."""
    if scans:
        return scans, errors
    if not errors:
        return [], [_scanless(folder, wanted, withheld, depth)]
    kept = [error for error in errors if isinstance(error, PassedOver) and not _is_of_no_scan(error)]
    wrong = [error for error in errors if not isinstance(error, PassedOver) or _is_of_no_scan(error)]
    if wrong and all(map(_is_of_no_scan, wrong)) and (depth or telling_format(folder, wanted.wanted) is not None):
        own = _scanless(folder, wanted, withheld, depth)
        telling = [error for error in wrong if _LOOKS in error.problem]
        return [], [*kept, *(telling if telling and _LOOKS not in own.problem else [own])]
    if depth and len(errors) > 1 and all(_WRITTEN in error.problem for error in errors):
        return [], [PassedOver(folder.name, "", f"all that lies in it was {_WRITTEN}, not scans")]
    return [], errors


def _below(folder: Path, wanted: Search, depth: int, files: Sequence[Path]) -> Found:
    """Scans in the folders of a folder. `files` are scans that are known already: textures next to them are theirs."""
    scans: list[Scan] = []
    errors: list[InputError] = []
    written: dict[str, str] = {}
    for child in folders_in(folder):
        if is_junk(child.name):
            continue
        if depth >= MAX_DEPTH:
            errors += [] if any(path.is_relative_to(child) for path in files) else _too_deep(child, wanted)
            continue
        try:
            if product := product_of(child) if wanted.admits(child) else "":
                written[child.name] = product
                continue
            if files and is_material(child) and not is_framed(child):
                continue
        except OSError as error:
            errors.append(unreadable(child, error))
            continue
        more, wrong = search(child, wanted, depth + 1)
        scans += more
        errors += wrong
    if written:
        kinds = [f"{name} ({kind.partition(' ')[2]})" for name, kind in written.items()]
        ending = f" and {counted(len(kinds) - MAX_FOLDERS_NAMED, 'more folder')}" if len(kinds) > MAX_FOLDERS_NAMED else ""
        errors.append(_written_line(folder, ", ".join(kinds[:MAX_FOLDERS_NAMED]) + ending))
    return scans, errors


def _recorded(folder: Path, wanted: Search) -> Scan | None:
    """The scan that `folder` itself is, other than a file by itself. Names decide, wherever links among them lead."""
    for format in wanted.wanted:
        if not format.suffixes and (name := format.recognize(folder)) is not None:
            return wanted.scan(format, folder, name)
    return None


def _format(scan: Scan, wanted: Search) -> ScanFormat:
    return next(format for format in wanted.wanted if format.name == scan.format)


def _unread(folder: Path, scan: Scan, wanted: Search) -> list[Path]:
    """Meshes in the folder of a recorded scan that neither its reader reads nor its format has."""
    format = _format(scan, wanted)
    suffixes = tuple({suffix for other in wanted.formats for suffix in other.suffixes})
    paths = [path for path in _meshes_below(folder, suffixes) if not matches(path.relative_to(folder).as_posix(), format.unread)]
    paths = [path for path in paths if not is_product(path)]
    read = _read(scan, wanted) if paths else None
    if read is None:
        return []
    models = _models(paths, sorted(read)) if format.is_modelled else set()
    return [path for path in paths if path not in read and path not in models]


def _read(scan: Scan, wanted: Search) -> set[Path] | None:
    """Files that the reader of a scan reads; None for a scan that cannot be used, of which the run says so."""
    try:
        return set(_format(scan, wanted).files(scan, scan.premises))
    except InputError:
        return None


def _inner(folder: Path, scan: Scan, wanted: Search) -> list[str]:
    """Recorded scans in folders of a recorded scan that its reader does not read: their paths, and their formats."""
    if not scan_folders(folder, wanted.admits):
        return []
    read = _read(scan, wanted)
    passed = {place for path in read or () for place in path.parents}
    unread = _format(scan, wanted).unread

    def is_passed(place: Path) -> bool:
        return place in passed or matches(place.relative_to(folder).as_posix(), unread)

    return [] if read is None else enclosed_scans(folder, wanted.formats, wanted.admits, is_passed)


def _models(meshes: Sequence[Path], parts: Sequence[Path]) -> set[Path]:
    """Meshes that show what a scan next to them states: those of its name, and the only USDZ next to an only captured room."""
    stems = {(path.parent, path.stem) for path in parts}
    packages = [path for path in meshes if path.suffix.lower() == ".usdz"]
    only = packages if len(packages) == len(parts) == 1 and packages[0].parent == parts[0].parent else []
    return {path for path in meshes if (path.parent, path.stem) in stems} | set(only)


def _not_read(folder: Path, scan: Scan, unread: Sequence[Path], inner: Sequence[str]) -> list[InputError]:
    """Lines on meshes and scans in the folder of a recorded scan."""
    lines: list[InputError] = []
    if unread:
        problem = f"{_listed(unread, folder)} {'is' if len(unread) == 1 else 'are'} not part of the {scan.format} scan and not read"
        lines.append(PassedOver(folder.name, "", problem, "a mesh that is a scan by itself belongs into a folder of its own"))
    if inner:
        more = f" and {counted(len(inner) - MAX_NAMED, 'more folder')}" if len(inner) > MAX_NAMED else ""
        names, verb = ", ".join(inner[:MAX_NAMED]) + more, "is a scan" if len(inner) == 1 else "are scans"
        problem = f"{names} {verb} in the folder of the {scan.format} scan and not read"
        lines.append(PassedOver(folder.name, "", problem, "move it next to that folder"))
    return lines


def _meshes_below(folder: Path, suffixes: Sequence[str]) -> list[Path]:
    """Files below a folder with one of some endings, sorted; hidden ones, and what lies behind links, are left out."""
    meshes: list[Path] = []
    left = MAX_NAMES_BELOW
    level = [folder]
    for _ in range(MAX_DEPTH_BELOW):
        inner: list[Path] = []
        for place in level:
            try:
                paths = list(visible(place))
            except OSError:  # said of the scan that lies there
                continue
            left -= len(paths)
            for path in paths:
                ending = path.suffix.lower()
                if ending in suffixes and not path.is_dir():
                    meshes.append(path)
                elif (ending not in _FRAME_ENDINGS or ending in suffixes) and path.is_dir() and not path.is_symlink():
                    inner.append(path)
            if left <= 0:
                return sorted(meshes)
        level = inner
    return sorted(meshes)


def _too_deep(folder: Path, wanted: Search) -> list[InputError]:
    """The error of a folder that is too deep to be searched and has scans in it."""
    if folder.is_symlink():
        return []
    paths = [path for path in _meshes_below(folder, wanted.suffixes) if not is_product(path)]
    name = recorded_format(folder, wanted.wanted)
    scans = [f"a {name} scan"] if name else enclosed_scans(folder, wanted.wanted, wanted.admits)
    if not paths and not scans:
        return []
    place = "/".join(folder.parts[-MAX_DEPTH - 1 :])
    named = _listed(paths, folder) if paths else ", ".join(scans[:MAX_NAMED])
    problem = f"lies more than {MAX_DEPTH} folders deep and is not searched ({named})"
    return [UnusableScan(InputError(place, "folder", problem, "give a folder further down as --scans"), folder)]


def _same_names(scans: Iterable[Scan]) -> list[InputError]:
    """A line for files of one name in one folder: an app may have exported one scan in several formats."""
    files: dict[tuple[Path, str], list[Path]] = {}
    for path in sorted({scan.path for scan in scans if not scan.path.is_dir()}):
        files.setdefault((path.parent, path.stem), []).append(path)
    return [
        PassedOver(_listed(paths, folder), "", "have one name, and each is a scene", "if they show the same scan, keep one of them")
        for (folder, _), paths in files.items()
        if len(paths) > 1
    ]


_EMPTY, _NO_SCAN, _LOOKS, _WRITTEN = "is empty", "holds no scan of a known format", "; looks like ", "written by metascenes"


def _is_of_no_scan(error: InputError) -> bool:
    """True if an error only says that a folder holds no scan, not that something in it is wrong."""
    return error.problem == _EMPTY or error.problem.startswith(_NO_SCAN)


def _written_line(folder: Path, names: str) -> PassedOver:
    return PassedOver(folder.name, "", f"{names}: {_WRITTEN}, not scans", "")


def _scanless(folder: Path, wanted: Search, withheld: Sequence[Path] = (), depth: int = 0) -> UnusableScan | PassedOver:
    """The line on a folder without a scan in it: what it looks like, and what to do.

    Below the folder of scans, it is an error only if the folder looks like a scan of a wanted format.
    """
    if not any(visible(folder)):
        empty = InputError(folder.name, "folder", _EMPTY, f"expected {wanted.expected}")
        return _passed_over(empty) if depth else UnusableScan(empty, folder)
    problem = f"{_NO_SCAN} ({', '.join(format.name for format in wanted.wanted)})"
    if depth and len(wanted.wanted) < len(wanted.formats) and (other := _unwanted(folder, wanted)):
        return PassedOver(folder.name, "folder", f"{problem}; {other}", "")
    like = likeness(folder, wanted.wanted)
    remedy = f"expected {wanted.expected}"
    format = ""
    if like is not None:
        problem, remedy = f"{problem}; {like[0]}", like[1]
        format = like[0].removeprefix("looks like ").partition(" ")[0] if f"; {like[0]}".startswith(_LOOKS) else ""
    if withheld:
        remedy += f"; --format bare_mesh reads {_listed(withheld, folder)} as it is"
    error = InputError(folder.name, "folder", problem, remedy)
    return _passed_over(error) if depth and not (format or withheld) else UnusableScan(error, folder, format)


def _passed_over(error: InputError) -> PassedOver:
    return PassedOver(error.file, error.field, error.problem, error.remedy)


def _unwanted(folder: Path, wanted: Search) -> str:
    """The words on a folder that is, holds or looks like a scan of a format that is not wanted; '' for any other."""
    unwanted = [format for format in wanted.formats if format not in wanted.wanted]
    if name := recorded_format(folder, unwanted):
        return f"is a {name} scan"
    if any(files_named(folder, format.suffixes) for format in unwanted):
        return "has meshes"
    like = likeness(folder, wanted.formats)
    named = [format.name for format in unwanted if like is not None and f"; {like[0]}".startswith(f"{_LOOKS}{format.name} ")]
    return f"looks like {named[0]}" if named else ""


def _listed(paths: Sequence[Path], folder: Path) -> str:
    """Paths from a folder, the first ones by name."""
    names = [path.relative_to(folder).as_posix() for path in paths[:MAX_NAMED]]
    return ", ".join(names) + (f" and {counted(len(paths) - MAX_NAMED, 'more file')}" if len(paths) > MAX_NAMED else "")
