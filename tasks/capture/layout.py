"""Where the files of a scan lie: only names are looked at here, nothing is opened."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from schemas.files import stays_in
from tasks.capture.files.images import COLOR_SUFFIXES, DEPTH_SUFFIXES
from tasks.capture.files.stamps import last_digits, natural_order, partners
from tasks.capture.premises import Premises

_COLOR_FOLDERS = ("color", "colour", "rgb", "image", "images")
_DEPTH_FOLDERS = ("depth", "depths", "depth_image")
_POSE_FOLDERS = ("pose", "poses")
_FLAT = re.compile(r"(?P<key>.*?\d+)[._-](?P<what>color|colour|rgb|depth|pose)\.(?P<suffix>[A-Za-z]+)")
"""Frames side by side in one folder: `frame-000000.color.jpg`, `frame-000000.depth.pgm`, `frame-000000.pose.txt`."""

KEY_FRAMES = ("cameras", "corrected_cameras")
"""Folders of Polycam's raw data: a camera as JSON for each key frame, next to images and depth. The mesh is the scan."""

_LISTS = (("rgb.txt", "depth.txt"), ("odometry.csv", "camera_matrix.csv"))
"""Lists of TUM RGB-D and of Stray Scanner, next to folders that are called as those of exported frames are."""

_TRAJECTORIES = (
    "trajectory.log", "trajectory.txt", "traj.txt", "poses.txt", "pose.txt", "groundtruth.txt", "poses.log",
    "livingroom.freiburg", "CameraTrajectory.txt",
)  # fmt: skip
COLOR_INTRINSICS = (
    "intrinsic/intrinsic_color.txt", "intrinsics_color.txt", "intrinsic_color.txt", "intrinsics.json", "camera_intrinsic.json",
    "intrinsic.json", "intrinsics.txt", "intrinsic.txt", "camera-intrinsics.txt", "camera.txt", "K.txt",
)  # fmt: skip
STOREYS_RECORD = "storeys.json"
"""Beside the scans of a scan's storeys: how they are joined again. No format has it."""

DEPTH_INTRINSICS = ("intrinsic/intrinsic_depth.txt", "intrinsics_depth.txt", "intrinsic_depth.txt")


@dataclasses.dataclass(frozen=True)
class FrameFiles:
    """Files of one frame. `key` is what its files share: `12` of `color/12.jpg` and `depth/12.png`."""

    key: str
    color: Path
    depth: Path | None
    pose: Path | None


@dataclasses.dataclass(frozen=True)
class FrameLayout:
    """Exported frames of a scan, sorted by the numbers in their names.

    unpaired: files of depth that no color image belongs to, among them those of kinds that are not read.
    """

    folder: Path
    frames: tuple[FrameFiles, ...]
    trajectory: Path | None
    color_intrinsics: Path | None
    depth_intrinsics: Path | None
    unpaired: tuple[Path, ...] = ()

    @property
    def files(self) -> list[Path]:
        """Every file that the frames are read from."""
        paths = [path for frame in self.frames for path in (frame.color, frame.depth, frame.pose)]
        return [path for path in (*paths, self.trajectory, self.color_intrinsics, self.depth_intrinsics) if path is not None]


def frame_layout(folder: Path, premises: Premises | None = None, above: bool = False) -> FrameLayout | None:
    """Exported frames in `folder` or in one folder in it (`<scan>_2d`, `frames`, ...); None without any.

    Links that leave the premises, by default those that leave the folder, are left out. above: Intrinsics may lie one folder above,
    too, as where several walks were recorded with one camera.
    """
    premises = premises or Premises((folder,))
    for place in (folder, *(place for place in folders_in(folder) if premises.admits(place) and not _is_recording(place))):
        frames = _paired(place, premises) or _flat(place, premises)
        if frames:
            places = (place, folder)
            shared = (*places, folder.parent) if above else places
            return FrameLayout(
                folder=place,
                frames=tuple(frames),
                trajectory=None if any(frame.pose for frame in frames) else _first(places, _TRAJECTORIES, premises),
                color_intrinsics=_first(shared, COLOR_INTRINSICS, premises),
                depth_intrinsics=_first(shared, DEPTH_INTRINSICS, premises),
                unpaired=_unpaired(place, frames, premises),
            )
    return None


def is_framed(folder: Path) -> bool:
    """Whether `folder` is one of exported frames by the names in it, wherever links among them lead."""
    return bool(_paired(folder, None) or _flat(folder, None))


def has_key_frames(folder: Path) -> bool:
    """True if a folder holds the key frames of Polycam's raw data."""
    return any((folder / name).is_dir() and any((folder / name).glob("*.json")) for name in KEY_FRAMES)


def is_frame_name(name: str) -> bool:
    """True if a file has the name of a frame in a flat folder of frames."""
    return _FLAT.fullmatch(name) is not None


def frame_ids(keys: Iterable[str]) -> list[str]:
    """Six-digit ids of frames: the number that a name is or ends with. The position if one is a decimal, repeats or is too long."""
    names = list(keys)
    numbers = [last_digits(name) for name in names]
    usable = all(number and len(number.lstrip("0")) <= 6 for number in numbers)
    ids = [f"{int(number or 0):06d}" for number in numbers] if usable else []
    return ids if usable and len(set(ids)) == len(ids) else [f"{index:06d}" for index in range(len(names))]


def _paired(place: Path, premises: Premises | None) -> list[FrameFiles]:
    """Frames of folders `color`, `depth`, `pose` (or their usual other names); of links by their names, without premises."""
    color, depth, pose = (_first((place,), names, premises) for names in (_COLOR_FOLDERS, _DEPTH_FOLDERS, _POSE_FOLDERS))
    if color is None or not color.is_dir() or depth is None or not depth.is_dir() or has_key_frames(place):
        return []
    colors, depths = _by_stem(color, COLOR_SUFFIXES, premises), _by_stem(depth, DEPTH_SUFFIXES, premises)
    poses = _by_stem(pose, (".txt",), premises) if pose is not None and pose.is_dir() else {}
    depth_of, pose_of = partners(list(colors), list(depths)), partners(list(colors), list(poses))
    keys = sorted(colors, key=natural_order)
    return [FrameFiles(key, colors[key], depths.get(depth_of.get(key, "")), poses.get(pose_of.get(key, ""))) for key in keys]


def _is_recording(place: Path) -> bool:
    """True if a folder is a recording of a format of its own by the lists in it: its frames are not those of the scan above it."""
    return any(all((place / name).exists() for name in names) for names in _LISTS)


def _unpaired(place: Path, frames: Sequence[FrameFiles], premises: Premises | None) -> tuple[Path, ...]:
    """Files in the folder of depth, of any kind, that are not the depth of a frame."""
    depth = _first((place,), _DEPTH_FOLDERS, premises)
    if depth is None or not depth.is_dir():
        return ()
    paired = {frame.depth for frame in frames}
    files = (path for path in sorted(depth.iterdir()) if not path.name.startswith(".") and path not in paired)
    return tuple(path for path in files if _is_admitted(path, premises) and path.is_file())


def _flat(place: Path, premises: Premises | None) -> list[FrameFiles]:
    """Frames whose files lie side by side in one folder."""
    by_kind: dict[str, dict[str, Path]] = {}
    for path in sorted(place.iterdir()):
        match = _FLAT.fullmatch(path.name)
        if match is None or path.is_dir():
            continue
        what, suffix = match["what"].replace("colour", "color").replace("rgb", "color"), f".{match['suffix'].lower()}"
        if suffix in {"color": COLOR_SUFFIXES, "depth": DEPTH_SUFFIXES, "pose": (".txt",)}[what] and _is_admitted(path, premises):
            by_kind.setdefault(match["key"], {})[what] = path
    whole = {key: files for key, files in by_kind.items() if "color" in files}
    if not any("depth" in files for files in whole.values()):
        return []
    return [
        FrameFiles(key, whole[key]["color"], whole[key].get("depth"), whole[key].get("pose")) for key in sorted(whole, key=natural_order)
    ]


def _by_stem(folder: Path, suffixes: tuple[str, ...], premises: Premises | None) -> dict[str, Path]:
    named = (path for path in sorted(folder.iterdir()) if path.suffix.lower() in suffixes and not path.name.startswith("."))
    return {path.stem: path for path in named if _is_admitted(path, premises)}


def folders_in(folder: Path) -> list[Path]:
    """Folders in a folder, sorted, but for hidden ones and links to what it lies in itself."""
    folders = sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    return [path for path in folders if not leads_up(path)]


def leads_up(folder: Path) -> bool:
    """Whether a folder is a link to one that it lies in: whoever follows it walks in a circle."""
    return folder.is_symlink() and stays_in(folder.parent, folder)


def _first(places: Iterable[Path], names: Iterable[str], premises: Premises | None) -> Path | None:
    """The first that is there. What lies in a folder in a place is not there when the folder is a link that leaves."""
    for path in (place / name for place in places for name in names):
        above = path.parent
        if (path.exists() or path.is_symlink()) and _is_admitted(above, premises) and _is_admitted(path, premises):
            return path
    return None


def _is_admitted(path: Path, premises: Premises | None) -> bool:
    return premises is None or premises.admits(path)
