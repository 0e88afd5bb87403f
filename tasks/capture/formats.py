"""Which scans a folder holds, in which format, and which files each is read from. Opens nothing but LICENSE.txt."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from schemas.errors import InputError
from tasks.capture.layout import frame_layout, scannet_layout

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
    """A scan that was found. `path` is its folder, or its file for a GLB that lies beside others."""

    format: str
    path: Path
    dataset: str
    scan: str

    @property
    def scene_id(self) -> str:
        """`<dataset>/<scan>`, both reduced to what a scene id may hold."""
        return f"{_word(self.dataset).lower()}/{_word(self.scan)}"

    @property
    def room_id(self) -> str:
        """The physical room: rescans `scene0001_00`, `scene0001_01` of ScanNet are one; otherwise the scene itself."""
        match = re.fullmatch(r"(.*/scene\d{4})_\d{2}", self.scene_id)
        return match[1] if match and self.format == "scannet" else self.scene_id


def find_scans(folder: Path, format: str = "auto", dataset: str | None = None) -> tuple[list[Scan], list[InputError]]:
    """Scans in `folder`, which is one scan or a folder of scans, sorted by scene id; and what is wrong with the rest.

    Hidden files, and plain files that are no scan, are passed over. A folder in which no scan is found or that cannot be
    read, and two scans that would be one scene, are errors; all other scans are still returned.

    Raises:
        InputError: the format is not known, or `folder` does not exist.
    """
    if format not in ("auto", *FORMATS):
        raise InputError("--format", "format", f"{format!r} is not known", f"use auto, {', '.join(FORMATS)}")
    wanted = FORMATS if format == "auto" else (format,)
    try:
        exists = folder.exists()
    except OSError as error:
        return [], [_unreadable(folder, error)]
    if not exists:
        raise InputError(folder.name or str(folder), "folder", "does not exist", "name a scan, or a folder of scans")
    folder = folder.resolve()
    found, errors = _search(folder, wanted, dataset, depth=0)
    by_scene: dict[str, list[Scan]] = {}
    for scan in found:
        by_scene.setdefault(scan.scene_id, []).append(scan)
    scans = []
    for scene_id, same in sorted(by_scene.items()):
        if len(same) == 1:
            scans += same
            continue
        places = ", ".join(sorted(_below(scan.path, folder) for scan in same))
        errors.append(InputError(places, "scan", f"are all scene {scene_id}", "rename all but one, or give them different datasets"))
    return scans, errors


def scan_files(scan: Scan) -> list[Path]:
    """All files that the reader of the scan's format would read, sorted. Their content is what the scene depends on."""
    folder = scan.path if scan.path.is_dir() else scan.path.parent
    files: list[Path] = []
    if scan.format == "scannet":
        scannet = scannet_layout(folder)
        files = scannet.files if scannet else []
    elif scan.format == "posed_rgbd":
        frames = frame_layout(folder)
        files = frames.files if frames else []
    elif scan.format == "glb":
        files = [glb_file(scan.path)]
    license_file = folder / "LICENSE.txt"
    return sorted({*files, *([license_file] if license_file.is_file() else [])})


def glb_file(path: Path) -> Path:
    """The GLB of a scan that is a file, or a folder with one GLB in it.

    Raises:
        InputError: the folder does not hold exactly one.
    """
    if path.is_file():
        return path
    files = _glbs(path)
    if len(files) != 1:
        raise InputError(path.name, "folder", f"holds {len(files)} .glb files, one is expected", "name the file itself")
    return files[0]


def _search(folder: Path, wanted: tuple[str, ...], dataset: str | None, depth: int) -> tuple[list[Scan], list[InputError]]:
    """What `_listed` finds; a folder that cannot be read, or a scan that cannot be one, is an error of its own."""
    try:
        return _listed(folder, wanted, dataset, depth)
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


def _listed(folder: Path, wanted: tuple[str, ...], dataset: str | None, depth: int) -> tuple[list[Scan], list[InputError]]:
    if folder.is_file():
        if folder.suffix.lower() == ".glb" and "glb" in wanted:
            return [_scan("glb", folder, dataset, folder.stem)], []
        return [], [InputError(folder.name, "file", "is no scan", f"expected {_expected(wanted)}")]
    single = _single(folder, wanted, dataset)
    if single is not None:
        return [single], []
    scans = [_scan("glb", path, dataset, path.stem) for path in _glbs(folder)] if "glb" in wanted else []
    errors: list[InputError] = []
    for child in _children(folder) if depth < 2 else []:
        more, wrong = _search(child, wanted, dataset, depth + 1)
        scans, errors = scans + more, errors + wrong
    if not scans and not errors:
        is_empty = not any(folder.iterdir())
        problem = _EMPTY if is_empty else f"{_NO_SCAN} ({', '.join(wanted)})"
        errors.append(InputError(folder.name, "folder", problem, f"expected {_expected(wanted)}"))
    elif not scans and depth and all(map(_is_of_no_scan, errors)):
        # A folder without a scan anywhere below it is one mistake, not one for each of its folders.
        problem = f"{_NO_SCAN} ({', '.join(wanted)})"
        errors = [InputError(folder.name, "folder", problem, f"expected {_expected(wanted)}")]
    return scans, errors


def _single(folder: Path, wanted: tuple[str, ...], dataset: str | None) -> Scan | None:
    """The scan that `folder` itself is, or None."""
    if "scannet" in wanted and (layout := scannet_layout(folder)) is not None:
        return _scan("scannet", folder, dataset, layout.scan)
    if "posed_rgbd" in wanted and frame_layout(folder, inside=False) is not None:
        return _scan("posed_rgbd", folder, dataset, folder.name)
    if "glb" in wanted and len(_glbs(folder)) == 1 and not any(_is_recorded(child) for child in _children(folder)):
        return _scan("glb", folder, dataset, folder.name)
    return None


def _is_recorded(folder: Path) -> bool:
    """Whether a folder is a scan of frames or of a sensor's mesh; then what lies beside it is a scan of its own.

    So it is when the folder cannot be read: that is an error then, and not for a scan that would take it in.
    """
    try:
        return scannet_layout(folder) is not None or frame_layout(folder) is not None
    except (OSError, InputError):
        return True


def _children(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))


def _scan(format: str, path: Path, dataset: str | None, scan: str) -> Scan:
    return Scan(format, path, dataset or _DATASETS[format], scan)


def _glbs(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.is_file() and path.suffix.lower() == ".glb" and not path.name.startswith("."))


def _word(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", text).lstrip("_.-") or "scan"


def _expected(wanted: tuple[str, ...]) -> str:
    return "; or ".join(_EXPECTED[format] for format in wanted)


def _below(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix() if path != folder else folder.name
