"""Scans of further formats through every stage, to USD that passes its gate."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.tasks.capture.formats import test_roomplan, test_scannetpp
from tests.test_pipeline import QUICK

SAMPLES: dict[str, Callable[[Path], None]] = {"scannetpp": test_scannetpp.write_sample, "roomplan": test_roomplan.write_sample}
"""One with labelled vertices, and one that has nothing but boxes."""

FURNITURE = {"bag", "box", "cabinet", "chair", "mop", "refrigerator", "shelf", "shoe"}
"""Categories of what can be carried or pushed in the scan of MultiScan."""


@pytest.fixture
def command(tmp_path: Path) -> Callable[..., str]:
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("PREFECT_", "METASCENES_"))}
    home = {**kept, "HOME": str(tmp_path / "home"), "XDG_CACHE_HOME": str(tmp_path / "home" / ".cache")}

    def run(*words: object) -> str:
        done = subprocess.run([sys.executable, "-m", "flows.cli", *map(str, words)], env=home, capture_output=True, text=True, timeout=900)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return run


@pytest.mark.slow
@pytest.mark.whole
def test_a_scan_of_each_kind_becomes_usd(command: Callable[..., str], tmp_path: Path) -> None:
    for name, write in SAMPLES.items():
        write(tmp_path / "scans" / name / "home")
    lake = tmp_path / "lake"
    made = command("run", "--scans", tmp_path / "scans", "--lake", lake, "--workers", 1, *QUICK, "--set", 'exports.formats=["usd"]')
    assert f"{len(SAMPLES)} scenes done" in made

    def ask(query: str) -> list[Any]:
        return [list(row.values()) for row in json.loads(command("sql", "--lake", lake, query, "--json"))]

    checks = "SELECT scan_format, bool_and(passed) FROM export_checks JOIN scenes USING (scene_id) WHERE format = 'usd' GROUP BY ALL"
    assert sorted(ask(checks)) == [[name, True] for name in sorted(SAMPLES)]
    placed = (
        "SELECT DISTINCT scan_format, category FROM placements JOIN instances USING (scene_id, instance_id) JOIN scenes USING (scene_id)"
    )
    found = {tuple(row) for row in ask(placed)}
    assert {("scannetpp", "chair"), ("roomplan", "table"), ("roomplan", "chair"), ("roomplan", "cabinet")} <= found
    command("export", "--lake", lake, "--out", tmp_path / "out")
    assert len(list((tmp_path / "out" / "usd").glob("*/scene.usda"))) == len(SAMPLES)


@pytest.mark.slow
@pytest.mark.whole
def test_a_real_annotation_without_a_mesh_becomes_usd(command: Callable[..., str], realdata: Callable[[str], Path], tmp_path: Path) -> None:
    """The annotation of a real storeroom of MultiScan: boxes in, a scene that passes its gate out, with all its furniture placed.

    Its boxes reach up to 19 cm into each other and into walls: the search for their places is left its moves.
    """
    (annotation,) = realdata("multiscan_sample").glob("*.annotations.json")
    scan, lake = tmp_path / "scan", tmp_path / "lake"
    scan.mkdir()
    shutil.copy(annotation, scan / annotation.name)
    made = command("run", "--scans", scan, "--lake", lake, "--workers", 1, "--set", 'exports.formats=["usd"]')
    assert "1 scene done" in made

    def ask(query: str) -> list[Any]:
        return [tuple(row.values()) for row in json.loads(command("sql", "--lake", lake, query, "--json"))]

    assert ask("SELECT scene_id, room_id, scan_format, instance_count FROM scenes") == [
        ("multiscan/scene_00000_00", "multiscan/scene_00000", "multiscan", 27)
    ]
    assert ask("SELECT DISTINCT passed FROM export_checks WHERE format = 'usd'") == [(True,)]
    placed = ask("SELECT category FROM placements JOIN instances USING (scene_id, instance_id)")
    assert {category for (category,) in placed} >= FURNITURE
