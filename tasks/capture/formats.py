"""Which scans a folder holds, in which format, and which files each is read from. Opens nothing but LICENSE.txt."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from pathlib import Path

from schemas.errors import InputError
from schemas.files import stays_in
from tasks.capture.layout import frame_layout, is_framed, leads_up, scannet_layout
from tasks.capture.premises import REMEDY, Premises, stores
from tasks.words import plain_word

FORMATS = ("scannet", "posed_rgbd", "glb")
"""Formats that are read, in the order in which they are looked for."""

_DATASETS = {"scannet": "scannet", "posed_rgbd": "rgbd", "glb": "glb"}
_EXPECTED = {
    "scannet": "<scan>_vh_clean_2.ply, .segs.json and .aggregation.json, or <scan>.sens",
    "posed_rgbd": "folders color and depth with poses and intrinsics",
    "glb": "one .glb file",
}


@dataclasses.dataclass(frozen=True)
class Scan:
    """A scan that was found. `path` is its folder, or its file for a GLB that lies beside others.

    places: Folders, links followed, that links of the scan may lead into; without any, the scan's own.
    """

    format: str
    path: Path
    dataset: str
    scan: str
    places: tuple[Path, ...] = dataclasses.field(default=(), compare=False)

    @property
    def folder(self) -> Path:
        """The folder that it lies in, or is."""
        return self.path if self.path.is_dir() else self.path.parent

    @property
    def premises(self) -> Premises:
        """What decides which of its links are followed."""
        return Premises(self.places or (self.folder,))

    @property
    def scene_id(self) -> str:
        """`<dataset>/<scan>`, both as plain words."""
        return f"{plain_word(self.dataset).lower()}/{plain_word(self.scan)}"

    @property
    def room_id(self) -> str:
        """The physical room: rescans `scene0001_00`, `scene0001_01` of ScanNet are one; otherwise the scene itself."""
        match = re.fullmatch(r"(.*/scene\d{4})_\d{2}", self.scene_id)
        return match[1] if match and self.format == "scannet" else self.scene_id


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
    if format not in ("auto", *FORMATS):
        raise InputError("--format", "format", f"{format!r} is not known", f"use auto, {', '.join(FORMATS)}")
    wanted = FORMATS if format == "auto" else (format,)
    allowed = stores(links_into)
    try:
        exists = folder.exists()
    except OSError as error:
        return [], [_unreadable(folder, error)]
    if not exists:
        raise InputError(str(folder), "folder", "does not exist", "name a scan, or a folder of scans")
    folder = folder.resolve()
    root = (folder if folder.is_dir() else folder.parent, *allowed) if isinstance(folder, Path) else ()  # a listing has no links
    found, errors = _search(folder, _Search(wanted, dataset, root), depth=0)
    by_scene: dict[str, list[Scan]] = {}
    for scan in _once(found):
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
    found: dict[tuple[str, Path], Scan] = {}
    for scan in scans:
        real = scan.path.resolve()
        if (scan.format, real) not in found or scan.path == real:
            found[scan.format, real] = scan
    return list(found.values())


def scan_files(scan: Scan) -> list[Path]:
    """All files that the reader of the scan's format would read, sorted. Their content is what the scene depends on."""
    return survey(scan)[0]


def left_out(scan: Scan) -> str:
    """Links of a scan that leave the folder of scans, in a line; '' when there are none."""
    return survey(scan)[1]


def survey(scan: Scan) -> tuple[list[Path], str]:
    """What `scan_files` and `left_out` say, with one look."""
    folder, premises = scan.folder, scan.premises
    files: list[Path] = []
    if scan.format == "scannet":
        scannet = scannet_layout(folder, premises)
        files = scannet.files if scannet else []
    elif scan.format == "posed_rgbd":
        frames = frame_layout(folder, premises=premises)
        files = frames.files if frames else []
    elif scan.format == "glb":
        files = [glb_file(scan)]
    license_file = license_path(folder, premises)
    if odd := [path.name for path in files if not _is_text(path.name)]:
        shown = odd[0].encode("utf-8", "backslashreplace").decode()
        raise InputError(f"{folder.name}/{shown}", "name", "is no UTF-8", "rename the file")
    return sorted({*files, *([license_file] if license_file else [])}), premises.note(folder)


def license_path(folder: Path, premises: Premises) -> Path | None:
    """A scan's LICENSE.txt, None without one. A link that leads nowhere is none."""
    path = folder / "LICENSE.txt"
    return path if (path.is_file() or path.is_symlink()) and premises.admits(path) and path.is_file() else None


def glb_file(scan: Scan) -> Path:
    """The GLB of a scan that is a file, or a folder with one GLB in it.

    Raises:
        InputError: the folder does not hold exactly one, or it is a link that leaves the folder of scans.
    """
    files = [scan.path] if not scan.path.is_dir() else _glbs(scan.path)
    if len(files) != 1:
        raise InputError(scan.path.name, "folder", f"holds {len(files)} .glb files, one is expected", "name the file itself")
    if not scan.premises.admits(files[0]):
        raise _leaving(files[0])
    return files[0]


def _leaving(path: Path) -> InputError:
    return InputError(path.name, "link", "leads out of the folder of scans", REMEDY)


@dataclasses.dataclass(frozen=True)
class _Search:
    """What is looked for: formats; the dataset that is named; and where links may lead."""

    wanted: tuple[str, ...]
    dataset: str | None
    places: tuple[Path, ...]

    def scan(self, format: str, path: Path, scan: str) -> Scan:
        own = (path.resolve(),) if self.places and path.is_dir() else ()
        return Scan(format, path, self.dataset or _DATASETS[format], scan, (*self.places, *own))

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
        if folder.suffix.lower() == ".glb" and "glb" in wanted:
            return [search.scan("glb", folder, folder.stem)], []
        return [], [InputError(folder.name, "file", "is no scan", f"expected {_expected(wanted)}")]
    single = _single(folder, search)
    if single is not None:
        return [single], []
    if depth and not search.admits(folder):
        return [], [_leaving(folder)]
    files = _glbs(folder) if "glb" in wanted else []
    scans = [search.scan("glb", path, path.stem) for path in files if search.admits(path)]
    errors = [_leaving(path) for path in files if not search.admits(path)]
    for child in _children(folder) if depth < 2 else []:
        more, wrong = _search(child, search, depth + 1)
        scans, errors = scans + more, errors + [error for error in wrong if str(error) not in map(str, errors)]
    if not scans and not errors:
        is_empty = not any(folder.iterdir())
        problem = _EMPTY if is_empty else f"{_NO_SCAN} ({', '.join(wanted)})"
        errors.append(InputError(folder.name, "folder", problem, f"expected {_expected(wanted)}"))
    elif not scans and depth and all(map(_is_of_no_scan, errors)):
        # A folder without a scan anywhere below it is one mistake, not one for each of its folders.
        problem = f"{_NO_SCAN} ({', '.join(wanted)})"
        errors = [InputError(folder.name, "folder", problem, f"expected {_expected(wanted)}")]
    return scans, errors


def _single(folder: Path, search: _Search) -> Scan | None:
    """The scan that `folder` itself is, or None. Names decide, wherever links among them lead."""
    wanted = search.wanted
    if "scannet" in wanted and (layout := scannet_layout(folder)) is not None:
        return search.scan("scannet", folder, layout.scan)
    if "posed_rgbd" in wanted and is_framed(folder):
        return search.scan("posed_rgbd", folder, folder.name)
    if "glb" in wanted and len(_glbs(folder)) == 1 and not any(_is_recorded(child) for child in _children(folder)):
        return search.scan("glb", folder, folder.name)
    return None


def _is_recorded(folder: Path) -> bool:
    """Whether a folder is a scan of frames or of a sensor's mesh; then what lies beside it is a scan of its own.

    So it is when the folder cannot be read: that is an error then, and not for a scan that would take it in.
    """
    try:
        return scannet_layout(folder) is not None or is_framed(folder) or any(map(is_framed, _children(folder)))
    except (OSError, InputError):
        return True


def _children(folder: Path) -> list[Path]:
    found = sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    return [path for path in found if not leads_up(path)]


def _glbs(folder: Path) -> list[Path]:
    """Whatever has the name of a GLB and is no folder."""
    named = (path for path in folder.iterdir() if path.suffix.lower() == ".glb" and not path.name.startswith("."))
    return sorted(path for path in named if not path.is_dir())


def _expected(wanted: tuple[str, ...]) -> str:
    return "; or ".join(_EXPECTED[format] for format in wanted)


def _is_text(name: str) -> bool:
    """Whether a name can be kept in tables: one whose bytes are no UTF-8 cannot."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _below(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix() if path != folder else folder.name
