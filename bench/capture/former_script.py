"""Run against the modules of a former commit, never imported: paths of scans in, what its capture stage found in their geometry out."""

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np


def found(path: Path) -> dict[str, Any]:
    """Surface, instances and alignment of a scan whose files name no instances."""
    from schemas.errors import InputError
    from tasks.capture import scenes
    from tasks.capture.formats import find_scans, format_of
    from tasks.capture.fusion import FusionConfig, fused_surface
    from tasks.capture.instances.segmentation import geometry_groups  # type: ignore[attr-defined]  # of that commit

    nothing = {
        "vertices": np.zeros((0, 3)),
        "faces": np.zeros((0, 3), np.int64),
        "owner": np.zeros(0, np.int64),
        "labels": np.zeros(0, str),
    }
    clock = time.perf_counter()
    try:
        (scan,), _ = find_scans(path)
        reading = scenes.read_scan(scan)
        surface = reading.surface
        if surface is None:
            surface, _ = fused_surface(reading.frames, FusionConfig(), path.name)
        alignment = scenes._aligned(reading, surface, [], is_authored=format_of(scan).is_modelled)
        groups, _ = geometry_groups(surface.transformed(alignment.pose))
    except (InputError, ValueError) as error:
        return {**nothing, "pose": np.eye(4), "seconds": time.perf_counter() - clock, "failure": str(error)}
    owner = np.full(len(surface.vertices), -1, dtype=np.int64)
    for index, group in enumerate(groups):
        owner[group.vertices] = index
    labels = np.array([group.raw_label for group in groups], dtype=str)
    seconds = time.perf_counter() - clock
    return {
        "vertices": surface.vertices, "faces": surface.faces, "owner": owner, "labels": labels, "pose": alignment.pose, "seconds": seconds,
        "failure": "",
    }  # fmt: skip


def main(request: Path, result: Path) -> None:
    """Read the request, leave a file for each scan."""
    scans = [Path(path) for path in json.loads(request.read_text())]
    if scans:
        found(scans[0])  # compiles
    for number, path in enumerate(scans):
        np.savez(result / f"{number}.npz", **found(path))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
