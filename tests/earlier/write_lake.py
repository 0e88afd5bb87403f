"""Write the lake that `tests/test_earlier.py` opens: every kind of thing that a lake may hold, small, by an earlier version.

It is run once for a version, with that version's own code, and what it wrote is kept:

    mkdir -p /tmp/version && git archive cb3911a | tar x -C /tmp/version
    PYTHONPATH=/tmp/version METASCENES_CACHE=/tmp/version-cache python tests/earlier/write_lake.py /tmp/earlier
    tar -C /tmp/earlier -c --sort=name --owner=0 --group=0 scans lake replicas batch.json review.json | xz -9e > tests/earlier/lake.tar.xz
    cp /tmp/earlier/catalog.json tests/earlier/

The lake of cb3911a holds two scans of one room, a room with frames, a scan that fails, one scene twice, under two datasets, and
one that was imported; a release, which it exported; and what came after that: a batch of annotations, its review, the scenes
redone, an evaluation.
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

HOST = "earlier"
"""What the lake says of the machine that wrote it."""


def main(folder: Path) -> None:
    """Write scans, lake, exported replicas and the files that were imported into `folder`, which must not be there."""
    from flows.bench.flows.small_scenes import SETTINGS

    folder.mkdir(parents=True)
    (folder / "catalog.json").write_text(json.dumps(catalog(), indent=1, sort_keys=True) + "\n")
    (folder / "site").mkdir()
    (folder / "site/sitecustomize.py").write_text(f"import socket\nsocket.gethostname = lambda: {HOST!r}\n")
    write_scans(folder / "scans")
    settings = [word for one in SETTINGS if not one.startswith("exports.") for word in ("--set", one)]
    run = ("run", "--scans", "scans", "--lake", "lake", "--workers", "1", *settings)
    metascenes(folder, *run, code=1)
    metascenes(folder, *run, "--scene", "scene0004_00", "--dataset", "other")
    metascenes(folder, "export", "--lake", "lake", "--scene", "other/scene0004_00", "--format", "habitat", "--out", "habitat")
    metascenes(folder, "import", "habitat", "habitat/habitat", "--dataset", "finished", "--lake", "lake")
    metascenes(folder, "release", "create", "v1", "--lake", "lake", "--notes", "before the annotations")
    metascenes(folder, "export", "--lake", "lake", "--release", "v1", "--scene", "scannet/scene0004_00", "--out", "replicas")
    scenes = ("scannet/scene0004_00", "scannet/scene0004_01")
    answer = {"instance_id": "0006", "annotator": "ada", "answered_at": "2026-03-01T14:05:00Z", "seconds": 12.5}
    answers = [{**answer, "scene_id": scene, "choice": 2 + index} for index, scene in enumerate(scenes)]
    (folder / "batch.json").write_text(json.dumps({"batch_id": "batch-1", "annotations": answers}))
    metascenes(folder, "annotate", "import", "batch.json", "--lake", "lake")
    verdict = {"review_id": "review-1", "reviewer": "bob", "reviewed_at": "2026-03-02T09:30:00Z", "sampled": 1, "wrong": 0}
    (folder / "review.json").write_text(json.dumps({"batch_id": "batch-1", "reviews": [verdict | {"verdict": "accepted"}]}))
    metascenes(folder, "annotate", "review", "review.json", "--lake", "lake")
    metascenes(folder, *run, code=1)
    metascenes(folder, "evaluate", "--policy", "expert", "--policy", "random", "--lake", "lake")


def catalog() -> dict[str, list[str]]:
    """Columns of every table and view, and of every macro what it gives: the names that people's SQL may hold."""
    from schemas.tables import TABLES
    from warehouse.catalog import described, empty_lake
    from warehouse.macros import macros
    from warehouse.views import views

    with empty_lake() as connection:
        asked = {one.name: list(described(connection, one).get("columns", {})) for one in (*views(), *macros())}
    return asked | {name: [column.name for column in table.columns] for name, table in TABLES.items()}


def write_scans(folder: Path) -> None:
    """Four scans of small rooms, two of them of one room, one cut short; and one of a furnished room, with frames."""
    from flows.bench.flows.small_scenes import write_small_scans
    from tasks.furniture.rooms import furnish
    from tasks.scanner import ScannerConfig, scan_scene

    for first in (1, 4, 7):
        write_small_scans(folder, 1, first=first)
    write_small_scans(folder / "again", 1, seed=1, first=4)
    for path in sorted((folder / "again/scene0004_00").iterdir()):
        if path.suffix in (".json", ".txt"):
            path.write_text(path.read_text().replace("scene0004_00", "scene0004_01"))
        path.rename(path.with_name(path.name.replace("scene0004_00", "scene0004_01")))
    (folder / "again/scene0004_00").rename(folder / "scene0004_01")
    (folder / "again").rmdir()
    mesh = folder / "scene0007_00/scene0007_00_vh_clean_2.ply"
    mesh.write_bytes(mesh.read_bytes()[:-1000])
    small = {"depth_width": 80, "depth_height": 60, "color_width": 80, "color_height": 60, "view_limit": 12, "voxel_m": 0.06}
    config = dataclasses.replace(ScannerConfig(), **small, least_looks=1.0, least_share=0.01)
    rng = np.random.default_rng(3)
    scan_scene(furnish("office", rng, object_count=3), folder, "scene0003_00", config, rng)
    (folder / "scene0003_00.truth.json").unlink()


def metascenes(folder: Path, *arguments: str, code: int = 0) -> None:
    """Give a command in `folder`; it must end with this exit code."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
    path = os.pathsep.join((str(folder / "site"), os.environ.get("PYTHONPATH", "")))
    told = {**kept, "PYTHONPATH": path, "HOME": str(folder / "home")}
    done = subprocess.run([sys.executable, "-m", "flows.cli", *arguments], cwd=folder, env=told, check=False)
    assert done.returncode == code, f"{' '.join(arguments)}: exit code {done.returncode}"


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute())
