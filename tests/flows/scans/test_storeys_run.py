"""A scan of two storeys as a person has it turned into scenes: captured, divided, run, both floors level at height 0, and neither the
other's rescan."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

from tasks.capture import CaptureConfig, find_scans
from tasks.capture import run as capture
from tasks.stage import Context
from tests.capture_scans import BoxRoom, write_scannet
from tests.tasks.capture.storeys.houses import Builder, House, stairs
from tests.test_pipeline import home, metascenes, run  # noqa: F401
from warehouse.lake import Lake

pytestmark = pytest.mark.whole

SIZE, RISE = (4.6, 4.2, 2.5), 2.8


def furnished_house() -> House:
    """Two rooms above one another with a cabinet and a box each, and stairs between them."""
    builder = Builder(step=0.08)
    for storey, z in enumerate((0.0, RISE)):
        builder.room(storey, (0, 0, z), SIZE)
        builder.box("cabinet", storey, (3.0, 0.1 + storey, z), (3.8, 0.6 + storey, z + 1.0))
        builder.box("chest", storey, (0.8, 0.8, z), (1.5, 1.3, z + 0.5))
    builder.add("stairs", 0, stairs(0.0, RISE, 3.0))
    return builder.house((0.0, RISE))


@pytest.mark.slow
def test_a_house_of_two_storeys_becomes_two_scenes_with_their_floors_at_zero(home: dict[str, str], tmp_path: Path) -> None:  # noqa: F811
    from pxr import Usd, UsdGeom

    house = furnished_house()
    write_scannet(tmp_path / "scans" / "scene0000_00", BoxRoom(house.surface, house.instance, house.labels, ()), frames="none")
    (tmp_path / "scans" / "scene0000_00" / "LICENSE.txt").write_text("CC0-1.0\n")
    (scan,), _ = find_scans(tmp_path / "scans")
    outcome = capture(scan=scan, context=Context(scan.scene_id, "capture", 0, {}), config=CaptureConfig())
    (line,) = (line for line in outcome.degradations if "storeys" in line)
    assert line.startswith("2 storeys, floors at 0.00 and 2.80 m, but a scene is of one, here of the lowest: metascenes storeys --scans ")
    words = shlex.split(line.partition(": metascenes ")[2].removesuffix(" makes a scan of each"))
    done = metascenes(home, *words[:-1], tmp_path / "storeys")  # the very command, into a folder of the test
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "1 scan divided, 0 unchanged, 0 of one storey, 0 failed"
    made = run(home, tmp_path / "storeys", tmp_path / "lake", "--set", 'exports.formats=["usd"]', "--workers", 1)
    assert made.returncode == 0, made.stderr
    connection = Lake.open(tmp_path / "lake").snapshot().connect()
    scenes = connection.execute("SELECT scene_id, room_id, alignment FROM scenes ORDER BY scene_id").fetchall()
    assert [row[:2] for row in scenes] == [(f"scannet/scene0000_00_floor{k}", f"scannet/scene0000_floor{k}") for k in (0, 1)]
    assert connection.execute("SELECT count(*) FROM rescans").fetchone() == (0,)
    lower, upper = (np.array(row[2]).reshape(4, 4) for row in scenes)
    between = lower @ np.linalg.inv(upper)  # the same axes, and the rise that there is between the floors
    assert between == pytest.approx(np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, RISE], [0, 0, 0, 1]]), abs=0.01)
    assert connection.execute("SELECT count(*) FROM export_checks WHERE NOT passed").fetchone() == (0,)
    placed = "SELECT scene_id, list(category ORDER BY category) FROM instances WHERE NOT is_structure AND category <> 'stairs' GROUP BY ALL"
    assert sorted(connection.execute(placed).fetchall()) == [(row[0], ["cabinet", "chest"]) for row in scenes]
    out = metascenes(home, "export", "--lake", tmp_path / "lake", "--out", tmp_path / "out")
    assert out.returncode == 0, out.stderr
    for scene, _, _ in scenes:
        stage = Usd.Stage.Open(str(tmp_path / "out" / "usd" / scene.replace("/", "_") / "scene.usda"))
        assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
        cache = UsdGeom.BBoxCache(Usd.TimeCode.Default(), [UsdGeom.Tokens.default_, UsdGeom.Tokens.render])

        def box(path: str, stage: Usd.Stage = stage, cache: UsdGeom.BBoxCache = cache) -> np.ndarray:
            bound = cache.ComputeWorldBound(stage.GetPrimAtPath(path)).ComputeAlignedRange()
            return np.array([bound.GetMin(), bound.GetMax()])

        floor = box("/World/Room/Floor/Visual")
        assert floor[1, 2] == pytest.approx(0.0, abs=1e-6)
        assert (floor[1] - floor[0])[:2] == pytest.approx(np.array(SIZE[:2]) + 0.2, abs=0.05)
        objects = [str(prim.GetPath()) for prim in stage.GetPrimAtPath("/World/Objects").GetChildren() if "stairs" not in prim.GetName()]
        assert len(objects) == 2
        assert all(box(path)[0, 2] == pytest.approx(0.0, abs=2e-3) for path in objects)
