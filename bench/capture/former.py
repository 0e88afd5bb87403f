"""What the code before segmentation of frames and meshes made of the same scans: that code itself, out of the repository's history."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import subprocess
import sys
import tarfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.machine.environment import child_environment

Array = NDArray[np.float64]

COMMIT = "9a5dbc58"
"""The last one in which instances without labels were clusters of fused voxels."""

_PATIENCE_S = 3600.0

_SCRIPT = Path(__file__).with_name("former_script.py")


@dataclasses.dataclass(frozen=True)
class FormerScan:
    """What was made of a scan. vertices: Scan frame [m], shape (n, 3). faces: Shape (m, 3). owner: Instance of each vertex, -1 for none,
    shape (n,). labels: Of the instances. pose: Scan frame to world frame, 4x4 [m]. failure: Why there is nothing, '' where there is."""

    vertices: Array
    faces: NDArray[np.int64]
    owner: NDArray[np.int64]
    labels: tuple[str, ...]
    pose: Array
    seconds: float
    failure: str = ""


def has_former() -> bool:
    """Whether the former code is in the repository's history here; a copy without history, or a shallow one, lacks it."""
    done = subprocess.run(
        ["git", "-C", str(Path(__file__).parents[2]), "cat-file", "-e", f"{COMMIT}^{{commit}}"],
        env=child_environment(),
        capture_output=True,
        check=False,
    )
    return done.returncode == 0


def former_scans(scans: Sequence[Path], workspace: Path) -> list[FormerScan]:
    """What the former code finds in scan folders without labels. workspace: An empty folder, for that code and what it writes.

    Raises:
        subprocess.CalledProcessError: the former code could not be taken out of the history, or did not run.
    """
    code = workspace / "code"
    code.mkdir(parents=True)
    archive = subprocess.run(
        ["git", "-C", str(Path(__file__).parents[2]), "archive", COMMIT, "schemas", "tasks"],
        env=child_environment(),
        capture_output=True,
        check=True,
    )
    with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
        files.extractall(code, filter="data")
    request, result = workspace / "request.json", workspace / "result"
    result.mkdir()
    request.write_text(json.dumps([str(scan.resolve()) for scan in scans]))
    around = {**os.environ, "PYTHONPATH": str(code), "METASCENES_CACHE": str(workspace / "cache")}
    command = [sys.executable, "-P", str(_SCRIPT), str(request), str(result)]
    subprocess.run(command, env=around, check=True, timeout=_PATIENCE_S, capture_output=True)
    return [_read(result / f"{number}.npz") for number in range(len(scans))]


def _read(path: Path) -> FormerScan:
    with np.load(path) as arrays:
        labels = tuple(str(label) for label in arrays["labels"])
        return FormerScan(
            arrays["vertices"], arrays["faces"], arrays["owner"], labels, arrays["pose"], float(arrays["seconds"]), str(arrays["failure"])
        )
