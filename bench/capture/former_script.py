"""Run against the modules of a former commit, never imported: paths of scans in, what its capture stage found in their geometry out."""

import json
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np


def former(path: Path) -> dict[str, Any]:
    """Surface, instances and alignment of a scan whose files name no instances."""
    capture = "tasks.capture"
    scenes, formats = import_module(f"{capture}.scenes"), import_module(f"{capture}.formats")
    fusion, segmentation = import_module(f"{capture}.fusion"), import_module(f"{capture}.instances.segmentation")
    errors = import_module("schemas.errors")

    nothing = {
        "vertices": np.zeros((0, 3)),
        "faces": np.zeros((0, 3), np.int64),
        "owner": np.zeros(0, np.int64),
        "labels": np.zeros(0, str),
    }
    clock = time.process_time()
    try:
        (scan,), _ = formats.find_scans(path)
        reading = scenes.read_scan(scan)
        surface = reading.surface
        if surface is None:
            surface, _ = fusion.fused_surface(reading.frames, fusion.FusionConfig(), path.name)
        alignment = scenes._aligned(reading, surface, [], is_authored=formats.format_of(scan).is_modelled)
        groups, _ = segmentation.geometry_groups(surface.transformed(alignment.pose))
    except (errors.InputError, ValueError) as error:
        return {**nothing, "pose": np.eye(4), "seconds": time.process_time() - clock, "failure": str(error)}
    owner = np.full(len(surface.vertices), -1, dtype=np.int64)
    for index, group in enumerate(groups):
        owner[group.vertices] = index
    labels = np.array([group.raw_label for group in groups], dtype=str)
    seconds = time.process_time() - clock
    return {
        "vertices": surface.vertices, "faces": surface.faces, "owner": owner, "labels": labels, "pose": alignment.pose, "seconds": seconds,
        "failure": "",
    }  # fmt: skip


def main(request: Path, result: Path) -> None:
    """Read the request, leave a file for each scan."""
    scans = [Path(path) for path in json.loads(request.read_text())]
    if scans:
        former(scans[0])  # compiles
    for number, path in enumerate(scans):
        np.savez(result / f"{number}.npz", **former(path))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
