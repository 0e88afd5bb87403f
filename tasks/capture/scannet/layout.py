"""Where the files of a ScanNet scan lie: only names are looked at here, nothing is opened."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from schemas.errors import InputError
from tasks.capture.layout import FrameLayout, frame_layout
from tasks.capture.premises import Premises


@dataclasses.dataclass(frozen=True)
class ScanNetLayout:
    """Files of a ScanNet scan that are read; None where there is none."""

    scan: str
    metadata: Path | None
    mesh: Path | None
    aggregation: Path | None
    segments: tuple[Path, ...]
    meshes: tuple[Path, ...]
    sens: Path | None
    frames: FrameLayout | None

    @property
    def files(self) -> list[Path]:
        """Every file that the scan may be read from."""
        single = [path for path in (self.metadata, self.aggregation, self.sens) if path is not None]
        return single + list(self.meshes) + list(self.segments) + (self.frames.files if self.frames else [])


def scannet_layout(folder: Path, premises: Premises | None = None) -> ScanNetLayout | None:
    """Files of a ScanNet scan in `folder`, whatever of them there is; None when nothing in it looks like one.

    The scan's name is the folder's where files begin with it, else what the files themselves begin with. Links that leave
    the premises, by default those that leave the folder, count as names and are left out as files.

    Raises:
        InputError: what should be the aggregation is a folder.
    """
    premises = premises or Premises((folder,))
    names = sorted(path.name for path in folder.iterdir() if not path.is_dir() and not path.name.startswith("."))
    scans = sorted({match[1] for name in names if (match := _SCANNET.fullmatch(name))})
    if not scans:
        return None
    scan = folder.name if folder.name in scans else scans[0]
    read = (".txt", ".ply", ".json", ".sens")
    mine = [name for name in names if name.startswith((f"{scan}.", f"{scan}_vh_clean")) and name.endswith(read)]
    mine = [name for name in mine if premises.admits(folder / name)]
    meshes = tuple(folder / name for name in (f"{scan}_vh_clean_2.ply", f"{scan}_vh_clean.ply") if name in mine)
    segments = tuple(folder / name for name in mine if name.endswith(".segs.json"))
    aggregation = [name for name in (f"{scan}{ending}" for ending in _AGGREGATIONS) if name in mine]
    for name in (f"{scan}{ending}" for ending in _AGGREGATIONS):
        if (folder / name).is_dir():
            raise InputError(f"{folder.name}/{name}", "file", "is a folder", "put the aggregation's JSON file in its place")
    frames = frame_layout(folder, premises=premises)
    return ScanNetLayout(
        scan=scan,
        metadata=folder / f"{scan}.txt" if f"{scan}.txt" in mine else None,
        mesh=meshes[0] if meshes else None,
        aggregation=folder / aggregation[0] if aggregation else None,
        segments=segments,
        meshes=meshes,
        sens=None if frames or f"{scan}.sens" not in mine else folder / f"{scan}.sens",
        frames=frames,
    )


_AGGREGATIONS = (".aggregation.json", "_vh_clean.aggregation.json")
_SCANNET = re.compile(
    r"(.+?)(?:_vh_clean(?:_2)?\.ply|_vh_clean(?:_2)?(?:\.\d+\.\d+)?\.segs\.json|(?:_vh_clean)?\.aggregation\.json|\.sens)"
)
