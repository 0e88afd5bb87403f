"""What differs between two snapshots, against a comparison of all rows in Python."""

from __future__ import annotations

import dataclasses
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import duckdb
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from flows.cli import cli
from schemas.captions import Caption
from schemas.capture import Instance, Scene, Shell
from schemas.errors import InputError
from schemas.record import Table
from schemas.tables import TABLES
from tests.samples import fingerprint, sample, stage_run
from tests.warehouse.lake_load import scene_id, stage_scene
from warehouse.lake import Lake
from warehouse.release import make_release
from warehouse.release.difference import Difference, difference, named_snapshot
from warehouse.tables.snapshot import Reader


def compared(before: Reader, after: Reader) -> tuple[dict[str, tuple[int, int, int]], dict[str, dict[str, list[str]]]]:
    """Rows by table, and names of scenes and objects, by what became of them: every row is looked at."""
    counts, about = {}, {"scenes": defaultdict(set), "objects": defaultdict(set)}
    for name, table in TABLES.items():
        if name in ("snapshots", "releases"):
            continue
        old, new = by_key(before, table), by_key(after, table)
        kinds = {key: "removed" if key not in new else "added" if key not in old else "changed"
                 for key in old.keys() | new.keys() if old.get(key) != new.get(key)}  # fmt: skip
        counts[name] = tuple(list(kinds.values()).count(kind) for kind in ("added", "changed", "removed"))
        if not table.stage:
            continue
        for key, kind in kinds.items():
            fields = dict(zip(table.key, key, strict=True))
            if "scene_id" in fields:
                about["scenes"][fields["scene_id"]].add((name, kind))
                if "instance_id" in fields:
                    about["objects"][f"{fields['scene_id']}/{fields['instance_id']}"].add((name, kind))
    named = {}
    for what, table_name in (("scenes", "scenes"), ("objects", "instances")):
        named[what] = {
            kind: sorted(name for name, seen in about[what].items() if (table_name, kind) in seen) for kind in ("added", "removed")
        }
        if what == "objects":  # walls, floors and ceilings are none; what was one of them and is an object now was added
            rows = [{f"{r.scene_id}/{r.instance_id}": r.is_structure for r in side.rows(Instance)} for side in (before, after)]
            old, new = ({name for name, is_structure in side.items() if not is_structure} for side in rows)
            parts = (rows[0].keys() | rows[1].keys()) - old - new
            about[what] = {name: seen for name, seen in about[what].items() if name not in parts}
            named[what] = {"added": sorted(about[what].keys() & new - old), "removed": sorted(about[what].keys() & old - new)}
        moved = {*named[what]["added"], *named[what]["removed"]}
        named[what]["changed"] = sorted(name for name in about[what] if name not in moved)
    return counts, named


def by_key(reader: Reader, table: Table) -> dict[tuple[Any, ...], Any]:
    """What does not vary from run to run of every row, by key."""
    kept = [c.name for c in table.columns if not c.volatile]
    return {
        tuple(getattr(row, name) for name in table.key): tuple(getattr(row, name) for name in kept) for row in reader.rows(table.record)
    }


def check_against_rows(found: Difference, before: Reader, after: Reader) -> None:
    counts, named = compared(before, after)
    assert {one.table: (one.added, one.changed, one.removed) for one in found.tables} == counts
    for what in ("scenes", "objects"):
        for kind in ("added", "changed", "removed"):
            told = getattr(getattr(found, what), kind)
            assert (told.count, list(told.names)) == (len(named[what][kind]), named[what][kind]), (what, kind)


steps = st.lists(
    st.lists(st.tuples(st.integers(0, 4), st.sampled_from(["a", "b", "remove"])), min_size=1, max_size=4, unique_by=lambda step: step[0]),
    min_size=1,
    max_size=4,
)


@pytest.mark.slow
@pytest.mark.whole
@settings(max_examples=3, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(history=steps)
def test_every_pair_of_snapshots_differs_as_its_rows_say(history: list, tmp_path_factory: pytest.TempPathFactory) -> None:
    lake = Lake.open(tmp_path_factory.mktemp("history") / "lake")
    stage_scene(lake, 0, "a", at=0)
    lake.commit()
    at = 0.0
    for step in history:
        for number, tag in step:
            at += 10
            if tag == "remove":
                lake.remove_scene(scene_id(number))
            else:
                stage_scene(lake, number, tag, at=at)
        lake.commit()
    last = lake.snapshot().snapshot_id
    for one in range(1, last + 1):
        before, after = lake.snapshot(one), lake.snapshot(last)
        check_against_rows(difference(lake, before, after, None), before, after)
        check_against_rows(difference(lake, after, before, None), after, before)


LISTS = [(), ((),), ((1.0,),), ((1.0, 2.0),), ((1.0,), (2.0,)), ((1.0, 2.0), ()), ((2.0, 1.0),), ((0.0,),), ((),) * 2]


@pytest.mark.whole
def test_lists_that_end_elsewhere_differ(tmp_path: Path) -> None:
    """DuckDB's hash takes [[1], [2]] for [[1, 2]], and [] for NULL."""
    assert duckdb.sql("SELECT hash([[1], [2]]) = hash([[1, 2]]) AND hash([]::INT[]) = hash(NULL::INT[])").fetchall() == [(True,)]
    lake = Lake.open(tmp_path / "lake")
    scene, blob = scene_id(0), lake.blobs.put(b"mesh", "glb")
    for i, walls in enumerate(LISTS):
        rows = {
            "scenes": [sample(Scene, scene_id=scene, mesh_blob=blob)],
            "shells": [sample(Shell, scene_id=scene, walls=walls, floor_color=None)],
        }
        lake.stage_rows(stage_run(scene, "capture", fingerprint(i), at=i), rows)
        lake.commit()
    for one in range(1, len(LISTS) + 1):
        for other in range(one, len(LISTS) + 1):
            found = difference(lake, lake.snapshot(one), lake.snapshot(other))
            rooms = next(table for table in found.tables if table.table == "shells")
            assert (rooms.added, rooms.changed, rooms.removed) == (0, int(one != other), 0), (LISTS[one - 1], LISTS[other - 1])


def test_times_and_hosts_do_not_count(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    scene, blob = scene_id(0), lake.blobs.put(b"mesh", "glb")
    for i in range(2):
        row = sample(Scene, scene_id=scene, mesh_blob=blob, scan_path=f"/scans/{i}")
        lake.stage_rows(stage_run(scene, "capture", fingerprint(i), at=i, host=f"h{i}"), {"scenes": [row]})
        lake.commit()
    found = difference(lake, lake.snapshot(1), lake.snapshot(2))
    assert {one.table for one in found.tables if one.added or one.changed or one.removed} == {"stage_runs"}
    assert found.scenes.changed.count == 0


@pytest.mark.whole
def test_names_are_cut_and_all_on_request(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    stage_scene(lake, 0, "x", at=0)
    lake.commit()
    for number in range(1, 30):
        stage_scene(lake, number, "x", at=number)
    lake.commit()
    make_release(lake, "v1", snapshot_id=1)
    run = CliRunner().invoke
    where = ["--lake", lake.address]
    told = json.loads(run(cli, ["release", "diff", "v1", "latest", "--json", *where]).output)
    assert told == json.loads(json.dumps(dataclasses.asdict(difference(lake, lake.snapshot(1), lake.snapshot()))))
    assert (told["before"], told["after"]) == (1, 2)
    assert told["scenes"]["added"] == {"count": 29, "names": [scene_id(number) for number in range(1, 21)]}
    every = json.loads(run(cli, ["release", "diff", "1", "2", "--scenes", "--json", *where]).output)
    assert every["scenes"]["added"]["names"] == [scene_id(number) for number in range(1, 30)]
    text = run(cli, ["release", "diff", "v1", "latest", *where]).output
    assert "scenes added: 29, the first 20" in text
    assert text.count("  demo/s") == 40, "20 scenes and 20 objects"
    assert "no row differs" in run(cli, ["release", "diff", "v1", "1", *where]).output


@pytest.mark.whole
def test_a_word_means_a_release_a_number_or_the_newest(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    for i in range(3):
        stage_scene(lake, 0, i, at=i)
        lake.commit()
    make_release(lake, "v1", snapshot_id=2)
    assert [named_snapshot(lake, text).snapshot_id for text in ("v1", "1", "latest")] == [2, 1, 3]
    with pytest.raises(InputError, match="releases are v1; a number is a snapshot, latest the newest"):
        named_snapshot(lake, "v2")
    with pytest.raises(InputError, match="there is no snapshot 9"):
        named_snapshot(lake, "9")


def test_walls_and_floors_are_no_objects(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    scene = scene_id(0)

    def captured(at: int, *structures: bool) -> None:
        rows = [sample(Instance, scene_id=scene, instance_id=f"{i:04d}", is_structure=part) for i, part in enumerate(structures)]
        points = lake.blobs.put(b"points", "ply")
        rows = [dataclasses.replace(row, points_blob=points, mesh_blob=None, view_blob=None) for row in rows]
        run = stage_run(scene, "capture", fingerprint("capture", at), at=at)
        lake.stage_rows(run, {"scenes": [], "instances": rows})
        lake.commit()

    captured(1)
    captured(2, True, True, False, False, False)
    captured(3, True, False, True, False)
    objects = difference(lake, lake.snapshot(1), lake.snapshot(2)).objects
    assert (objects.added.count, objects.changed.count, objects.removed.count) == (3, 0, 0), "three objects, and two walls"
    objects = difference(lake, lake.snapshot(2), lake.snapshot(3)).objects
    assert objects.added.names == (f"{scene}/0001",), "a wall that turned out to be an object"
    assert objects.removed.names == (f"{scene}/0002", f"{scene}/0004"), "an object that is a wall, and one that is gone"
    assert objects.changed.count == 0
    (instances,) = [one for one in difference(lake, lake.snapshot(1), lake.snapshot(2)).tables if one.table == "instances"]
    assert instances.added == 5, "rows are rows"


def test_a_changed_caption_changes_its_object_and_its_scene_alone(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    scene = scene_id(0)
    for number in range(3):
        stage_scene(lake, number, "x", at=number)
    lake.commit()
    texts = [sample(Caption, scene_id=scene, instance_id=f"{i:04d}", sentence="other" if i == 3 else "x") for i in range(5)]
    capture = f"capture={fingerprint(scene, 'x', 'capture')}"
    lake.stage_rows(stage_run(scene, "captions", fingerprint("new"), capture, at=50), {"captions": texts})
    lake.commit()
    found = difference(lake, lake.snapshot(1), lake.snapshot(2))
    assert found.scenes.changed.names == (scene,)
    assert f"{scene}/0003" in found.objects.changed.names
    captions = next(one for one in found.tables if one.table == "captions")
    assert (captions.added, captions.changed, captions.removed) == (0, 1, 0)
