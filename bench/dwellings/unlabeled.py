"""The scan of a room without its labels: how many regions capture finds for each object."""

from __future__ import annotations

import math
from pathlib import Path

from bench.dwellings.judgement import standing_for
from bench.stages import run_stages
from schemas.capture import Instance
from tasks.scanner.truth import DwellingTruth
from warehouse.lake import Lake


def regions_without_labels(place: Path, truth: DwellingTruth, cores: int) -> float:
    """Regions that are no structure, over the objects that the annotation has; NaN where capture fails or nothing is annotated.

    Args:
        place: folder of the room, with its scan in `scans`; a copy of the mesh and a lake are written next to it.
        truth: of the scan.
        cores: that capture may use.
    """
    bare = place / "bare" / truth.scan
    bare.mkdir(parents=True)
    mesh = place / "scans" / truth.scan / f"{truth.scan}_vh_clean_2.ply"
    (bare / "mesh.ply").write_bytes(mesh.read_bytes())
    lake = Lake.open(place / "bare_lake")
    annotated = len(standing_for(truth))
    if not annotated or run_stages(lake, bare.parent, ("capture",), cores).error is not None:
        return math.nan
    lake.commit()
    return sum(not row.is_structure for row in lake.snapshot().rows(Instance)) / annotated
