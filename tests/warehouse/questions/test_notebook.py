"""The notebook of worked examples: every cell runs, and what it says agrees with the rows, counted in another way."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.warehouse.generator import generated_lake
from schemas.candidates import Candidate
from schemas.capture import Instance, Room, Scene, Shell
from schemas.navigation import Navmesh
from schemas.optimization import Certificate, Contact, Placement
from schemas.runs import StageRun
from schemas.selection import Selection
from tests.conftest import REPOSITORY
from tests.warehouse.questions.test_sql import state
from warehouse.lake import Lake

FILE = REPOSITORY / "docs" / "analysis.py"


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("METASCENES_CACHE", str(tmp_path_factory.mktemp("cache")))
        return generated_lake(30)


def cells(address: str) -> tuple[Sequence[Any], Mapping[str, Any]]:
    """What the cells show and define, run on a lake."""
    spec = importlib.util.spec_from_file_location("analysis", FILE)
    assert spec is not None
    assert spec.loader is not None
    notebook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(notebook)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("METASCENES_LAKE", address)
        return notebook.app.run()


@pytest.fixture(scope="module")
def run(lake: Lake) -> tuple[Sequence[Any], Mapping[str, Any]]:
    before = state(Path(lake.address))
    ran = cells(lake.address)
    assert state(Path(lake.address)) == before
    return ran


@pytest.mark.slow
@pytest.mark.whole
def test_every_question_has_a_chart_with_something_in_it(run: Any) -> None:
    from matplotlib.figure import Figure

    charts = [shown for shown in run[0] if isinstance(shown, Figure)]
    text = FILE.read_text()
    assert len(charts) == len(re.findall(r"^    # [0-9]+\. .*\?", text, re.MULTILINE)) == 11
    for chart in charts:
        (axes,) = chart.axes
        assert axes.get_title().endswith("?")
        assert axes.patches or axes.images or axes.lines
        chart.canvas.draw()


@pytest.mark.slow
@pytest.mark.whole
def test_what_is_said_agrees_with_the_rows(lake: Lake, run: Any) -> None:
    reader, found = lake.snapshot(), run[1]
    scenes = reader.rows(Scene)
    objects = [row for row in reader.rows(Instance) if not row.is_structure]
    assert found["headline"]["scenes"] == len(scenes) == 30
    assert found["headline"]["objects"] == len(objects)

    per_scene = Counter(row.scene_id for row in objects)
    assert found["objects"] == {"scene_id": sorted(s.scene_id for s in scenes), "objects": [per_scene[s] for s in sorted(per_scene)]}
    kinds = {scene: len({row.category for row in objects if row.scene_id == scene}) for scene in per_scene}
    assert found["categories"] == {"scene_id": sorted(kinds), "categories": [kinds[scene] for scene in sorted(kinds)]}

    counted = sorted(Counter(row.category for row in objects).items(), key=lambda item: (-item[1], item[0]))
    assert list(zip(found["frequent"]["category"], found["frequent"]["objects"], strict=True)) == counted[:20]

    assert found["volumes"]["category"]
    for category, q1, median, q3, low, high in zip(
        *(found["volumes"][name] for name in ("category", "q1_m3", "median_m3", "q3_m3", "whisker_low_m3", "whisker_high_m3")), strict=True
    ):
        volumes = np.array([row.box_volume_m3 for row in objects if row.category == category])
        assert np.allclose([q1, median, q3], np.quantile(volumes, [0.25, 0.5, 0.75]), rtol=1e-12)
        reach = 1.5 * (q3 - q1)
        assert np.isclose(low, min(q1, volumes[volumes >= q1 - reach].min()))
        assert np.isclose(high, max(q3, volumes[volumes <= q3 + reach].max()))

    rooms = {(row.scene_id, row.room_index): row for row in reader.rows(Room)}
    standing = Counter(
        (rooms[row.scene_id, row.room_index].room_type, row.category)
        for row in objects
        if row.category in [name for name, _ in counted[:15]]
    )
    assert {(room, name): count for room, name, count in zip(*found["standing"].values(), strict=True)} == standing
    assert found["rooms_by_category"].sum() == standing.total()

    held = Counter((row.scene_id, row.room_index) for row in objects)
    parted = found["parted"]
    told = {(scene, index): rest for scene, index, *rest in zip(*parted.values(), strict=True)}
    assert told == {key: [row.room_type, row.floor_area_m2, held[key]] for key, row in rooms.items()}


@pytest.mark.whole
def test_times_wins_and_outcomes_agree_with_the_rows(lake: Lake, run: Any) -> None:
    reader, found = lake.snapshot(), run[1]
    newest: dict[tuple[str, str], StageRun] = {}
    for row in sorted(reader.rows(StageRun), key=lambda row: (row.attempt, row.started_at)):
        if row.outcome == "done":
            newest[row.scene_id, row.stage] = row
    for stage, median, p95 in zip(*(found["timing"][name] for name in ("stage", "median_seconds", "p95_seconds")), strict=True):
        seconds = [row.seconds for (_, name), row in newest.items() if name == stage]
        assert np.allclose([median, p95], np.quantile(seconds, [0.5, 0.95]))

    offered = {(row.scene_id, row.instance_id, row.asset_id, row.slot): row.provider for row in reader.rows(Candidate)}
    first = {(row.scene_id, row.instance_id): (row.asset_id, row.slot) for row in reader.rows(Selection) if row.rank == 1}
    won = Counter((offered[scene, instance, asset, slot], slot) for (scene, instance), (asset, slot) in first.items())
    told = {(name, slot): count for name, slot, count in zip(*found["wins"].values(), strict=True)}
    assert {key: count for key, count in told.items() if count} == won

    deep = Counter(row.phase for row in reader.rows(Contact) if row.penetration_m > 0.002 and not row.is_allowed)
    assert found["collisions"]["before"] == [deep["proposed"]]
    assert found["collisions"]["after"] == [deep["optimized"]]

    verdicts = [row for row in reader.rows(Certificate) if row.engine == "mujoco" and not row.is_fixed]
    placed = {(row.scene_id, row.instance_id) for row in reader.rows(Placement)}
    mine = found["stable"]["engine"].index("mujoco")
    assert found["stable"]["free"][mine] == sum((row.scene_id, row.instance_id) in placed for row in verdicts)
    assert 0 < found["stable"]["within_1cm"][mine] <= found["stable"]["within_5cm"][mine] <= 1

    floors = {row.scene_id: row.floor_area_m2 for row in reader.rows(Shell)}
    areas = {(row.scene_id, row.agent): row.area_m2 / floors[row.scene_id] for row in reader.rows(Navmesh)}
    shares = {(scene, agent): share for scene, agent, share, _ in zip(*found["reach"].values(), strict=True)}
    assert shares.keys() == areas.keys()
    assert all(np.isclose(shares[key], areas[key]) for key in areas)


def test_an_empty_lake_has_charts_too(tmp_path: Path) -> None:
    shown, found = cells(str(tmp_path / "none"))
    assert found["headline"]["scenes"] == 0
    assert not (tmp_path / "none").exists()
    assert len(shown) > 10


@pytest.mark.whole
def test_it_is_a_script_that_stores_no_answers(lake: Lake) -> None:
    environment = os.environ | {"METASCENES_LAKE": lake.address, "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run([sys.executable, str(FILE)], capture_output=True, text=True, env=environment, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
    assert "'scenes': 30" in done.stdout
    assert FILE.stat().st_size < 20_000
