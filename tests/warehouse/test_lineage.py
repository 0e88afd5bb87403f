"""Lineage: every link of every object against SQL, damage that must be noticed, files and prims, pictures, and what people type."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flows.outputs.explain import explain, settings_of
from flows.outputs.export import write_exports
from schemas.candidates import Asset, Candidate
from schemas.capture import Instance, Scene
from schemas.errors import InputError
from schemas.lineage import Lineage
from schemas.optimization import APPLIED, Placement
from tasks.lineage.outline import outline
from tasks.lineage.pictures import FORMATS, draw_lineage
from tasks.lineage.places import places
from tests.capture_scans import OBJECTS, box_room, write_scannet
from tests.conftest import REPOSITORY
from tests.samples import fingerprint, sample, stage_run
from tests.test_pipeline import QUICK, metascenes
from warehouse.lake import Lake
from warehouse.questions.views import asked_by
from warehouse.release import make_release

pytestmark = pytest.mark.whole

SCENE = "scannet/scene0000_00"
SCHEMA = json.loads((REPOSITORY / "schemas" / "lineage" / "lineage.schema.json").read_text())


@dataclasses.dataclass(frozen=True)
class Made:
    """A lake of one room with a table and a box on it: run, then annotated, then run again; and its exports."""

    environment: dict[str, str]
    lake: Path
    exported: Path


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    base = tmp_path_factory.mktemp("lineage")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT_", "METASCENES_"))}
    environment = {**kept, "HOME": str(base / "home"), "XDG_CACHE_HOME": str(base / "home" / ".cache"), "NO_COLOR": "1"}
    write_scannet(base / "scans" / "scene0000_00", box_room((OBJECTS[0], OBJECTS[3]), cameras=8))
    command = ("run", "--scans", base / "scans", "--lake", base / "lake", "--workers", 2, *QUICK)
    first = metascenes(environment, *command)
    assert first.returncode == 0, first.stderr
    lake = Lake.open(base / "lake")
    query = "SELECT instance_id, asset_id FROM selections WHERE rank = 2 ORDER BY instance_id LIMIT 1"
    instance, asset = lake.snapshot().connect().execute(query).fetchall()[0]
    answers = [
        {"scene_id": SCENE, "instance_id": instance, "annotator": who, "answered_at": f"2026-01-0{day}T03:04:05+00:00", "choice": choice,
         "transform": None, "ranking": []}
        for day, who, choice in ((1, "ann", asset), (2, "bob", asset), (3, "cy", None))
    ]  # fmt: skip
    (base / "batch.json").write_text(json.dumps({"batch_id": "batch1", "annotations": answers}))
    trusted = ("--set", "annotation.unreviewed_imports_count=true")
    imported = metascenes(environment, "annotate", "import", base / "batch.json", "--lake", base / "lake", *trusted)
    assert imported.returncode == 0, imported.stderr
    second = metascenes(environment, *command)
    assert second.returncode == 0, second.stderr
    write_exports(lake, base / "out")
    return Made(environment, base / "lake", base / "out")


@pytest.fixture
def lake(made: Made) -> Lake:
    return Lake.open(made.lake)


def sql(lake: Lake, query: str, *values: Any) -> list[dict[str, Any]]:
    """Rows of a query, asked of DuckDB alone."""
    with lake.snapshot().connect(names=asked_by(query)) as connection:
        return connection.sql(query, params=list(values)).to_arrow_table().to_pylist()


def objects(lake: Lake) -> list[str]:
    return [row["instance_id"] for row in sql(lake, "SELECT instance_id FROM placements ORDER BY ALL")]


def facts_of(lineage: Lineage, kind: str, key: str) -> dict[str, Any]:
    node = lineage.nodes[f"{kind}:{key}"]
    assert not node.is_missing
    return dict(node.facts)


def targets(lineage: Lineage, source: str, role: str) -> set[str]:
    return {edge.target for edge in lineage.edges if (edge.source, edge.role) == (source, role)}


def sources(lineage: Lineage, target: str, role: str) -> set[str]:
    return {edge.source for edge in lineage.edges if (edge.target, edge.role) == (target, role)}


def test_the_story_of_every_object_is_what_sql_says(lake: Lake) -> None:
    rows = sql(
        lake,
        """
        SELECT p.*, i.category, i.raw_label, i.best_frames, s.scan_path, a.source, l.license, a.provider AS asset_provider, c.sentence,
               list_filter(r.reasons, lambda x: x LIKE 'scan=%')[1] AS scan_part
        FROM placements p JOIN instances i USING (scene_id, instance_id) JOIN scenes s USING (scene_id) JOIN assets a USING (asset_id)
        JOIN asset_licenses l USING (asset_id) JOIN captions c USING (scene_id, instance_id)
        JOIN current_runs r ON r.scene_id = p.scene_id AND r.stage = 'capture'
        """,
    )
    assert {row["origin"] for row in rows} == {"annotation", "selection"}
    for row in rows:
        lineage = explain(lake, f"{SCENE}/{row['instance_id']}")
        assert lineage.problems == ()
        key = f"{SCENE}/{row['instance_id']}"
        assert lineage.target == f"instance:{key}"
        assert facts_of(lineage, "instance", key)["category"] == row["category"]
        assert facts_of(lineage, "caption", key)["sentence"] == row["sentence"]
        assert facts_of(lineage, "scan", SCENE)["content_hash"] == row["scan_part"].removeprefix("scan=")
        assert facts_of(lineage, "scan", SCENE)["scan_path"] == row["scan_path"]
        placement = facts_of(lineage, "placement", key)
        assert placement["origin"] == row["origin"]
        assert placement["annotator"] == row["annotator"]
        assert placement["optimized_position_m"] == [row["optimized_pose"][at] for at in (3, 7, 11)]
        assert targets(lineage, f"placement:{key}", "uses") == {f"asset:{row['asset_id']}"}
        asset = facts_of(lineage, "asset", row["asset_id"])
        assert (asset["source"], asset["license"], asset["provider"]) == (row["source"], row["license"], row["asset_provider"])
        _check_choice(lake, lineage, row)
        _check_evidence(lake, lineage, row)
        _check_layout(lake, lineage, row)


def _check_choice(lake: Lake, lineage: Lineage, row: dict[str, Any]) -> None:
    """Annotation or selection, candidate, provider with its settings."""
    key = f"{SCENE}/{row['instance_id']}"
    candidates = sql(
        lake, "SELECT * FROM candidates WHERE instance_id = ? AND asset_id = ? ORDER BY slot", row["instance_id"], row["asset_id"]
    )
    if row["origin"] == "annotation":
        (chosen,) = targets(lineage, f"placement:{key}", "chosen by")
        (answer,) = sql(lake, "SELECT * FROM annotations WHERE annotator = ? AND instance_id = ?", row["annotator"], row["instance_id"])
        assert chosen == f"annotation:{answer['batch_id']}/{key}/{row['annotator']}"
        assert lineage.nodes[chosen].facts["answered_at"] == answer["answered_at"].isoformat()
        assert lineage.runs[lineage.nodes[chosen].run or ""].stage == "annotation"
        others = sources(lineage, f"instance:{key}", "answers for")
        assert len(others) == sql(lake, "SELECT count(*) AS n FROM annotations")[0]["n"] - 1
        slots = {f"candidate:{key}/{one['slot']}" for one in candidates}
        assert targets(lineage, chosen, "chose") - {f"asset:{row['asset_id']}"} <= slots
    else:
        (selection,) = sql(
            lake,
            "SELECT * FROM selections WHERE instance_id = ? AND asset_id = ? ORDER BY rank LIMIT 1",
            row["instance_id"],
            row["asset_id"],
        )
        (chosen,) = targets(lineage, f"placement:{key}", "proposed by")
        assert chosen == f"selection:{key}/{selection['rank']}"
        assert lineage.nodes[chosen].facts["score"] == selection["score"]
        assert targets(lineage, chosen, "scored") == {f"candidate:{key}/{selection['slot']}"}
    (node,) = lineage.of_kind("candidate")
    (candidate,) = (one for one in candidates if one["slot"] == node.facts["slot"])
    assert {name: node.facts[name] for name in ("provider", "is_fallback", "outcome", "reason")} == {
        name: candidate[name] for name in ("provider", "is_fallback", "outcome", "reason")
    }
    (config,) = sql(lake, "SELECT config FROM current_runs WHERE stage = 'candidates'")
    slot = json.loads(config["config"])["slots"][candidate["slot"] - 1]
    (provider,) = targets(lineage, node.id, "made by")
    assert lineage.nodes[provider].facts["settings"] == slot["fallback" if candidate["is_fallback"] else "provider"]


def _check_evidence(lake: Lake, lineage: Lineage, row: dict[str, Any]) -> None:
    """Masks and frames."""
    masks = sql(lake, "SELECT * FROM masks JOIN frames USING (scene_id, frame_id) WHERE instance_id = ?", row["instance_id"])
    assert masks
    found = sources(lineage, f"instance:{SCENE}/{row['instance_id']}", "shows") - {
        edge.source for edge in lineage.edges if edge.source.startswith("export")
    }
    assert found == {f"mask:{SCENE}/{one['frame_id']}/{row['instance_id']}" for one in masks}
    for one in masks:
        assert targets(lineage, f"mask:{SCENE}/{one['frame_id']}/{row['instance_id']}", "in") == {f"frame:{SCENE}/{one['frame_id']}"}
        assert facts_of(lineage, "frame", f"{SCENE}/{one['frame_id']}")["color_file"] == one["color_file"]
    assert {f"frame:{SCENE}/{frame}" for frame in row["best_frames"]} <= set(lineage.nodes)


def _check_layout(lake: Lake, lineage: Lineage, row: dict[str, Any]) -> None:
    """Support, moves, certificates, episodes, exports."""
    key = f"{SCENE}/{row['instance_id']}"
    (support,) = sql(lake, "SELECT * FROM supports WHERE instance_id = ?", row["instance_id"])
    parents = targets(lineage, f"support:{key}", "rests on")
    assert parents == ({f"instance:{SCENE}/{support['parent_id']}"} if support["parent_id"] else set())
    steps = sql(
        lake, "SELECT step FROM optimization_steps WHERE instance_id = ? AND outcome IN ? ORDER BY step", row["instance_id"], APPLIED
    )
    moves = facts_of(lineage, "moves", key)
    assert [one["step"] for one in moves["steps"] if one["instance_id"] == row["instance_id"]] == [one["step"] for one in steps]
    certificates = sql(lake, "SELECT engine FROM certificates WHERE instance_id = ?", row["instance_id"])
    assert sources(lineage, f"placement:{key}", "certifies") == {f"certificate:{key}/{one['engine']}" for one in certificates}
    episodes = sql(lake, "SELECT episode_id FROM episodes WHERE instance_id = ? ORDER BY 1", row["instance_id"])
    listed = lineage.nodes[f"episodes:{key}"].facts.get("episodes", []) if f"episodes:{key}" in lineage.nodes else []
    assert listed == [one["episode_id"] for one in episodes]
    (alike,) = sql(lake, "SELECT f_2cm, f_5cm, f_10cm, completeness_5cm FROM fidelity WHERE instance_id = ?", row["instance_id"])
    measured = lineage.nodes[f"fidelity:{key}"].facts
    assert {name: measured[name] for name in alike} == alike
    exports = {node.facts["format"]: node.facts for node in lineage.of_kind("export")}
    formats = sql(lake, "SELECT format, path, file_blob, passed FROM export_files WHERE role = 'scene'")
    assert set(exports) == {one["format"] for one in formats}
    for one in formats:
        assert exports[one["format"]]["file"] == f"{one['format']}/{one['path']}"
        assert exports[one["format"]]["file_blob"] == one["file_blob"]
        assert exports[one["format"]]["passed"] == one["passed"]
        (rules,) = sql(lake, "SELECT count(*) AS n FROM export_checks WHERE format = ?", one["format"])
        assert exports[one["format"]]["rules"] == rules["n"]


def test_stage_runs_are_those_that_wrote_the_rows(lake: Lake) -> None:
    rows = sql(
        lake,
        """
        SELECT r.*, s.created_at, list_filter(reasons, lambda x: x LIKE 'code=%')[1] AS code_part,
               list_filter(reasons, lambda x: x LIKE 'config=%')[1] AS config_part
        FROM current_runs r JOIN snapshots s USING (snapshot_id) WHERE stage NOT IN ('micro_scenes', 'evaluation')
        """,
    )
    found = {run.stage: run for instance in objects(lake) for run in explain(lake, f"{SCENE}/{instance}").runs.values()}
    assert set(found) == {row["stage"] for row in rows}
    for row in rows:
        run = found[row["stage"]]
        assert (run.fingerprint, run.attempt, run.seconds, run.host) == (row["fingerprint"], row["attempt"], row["seconds"], row["host"])
        assert (run.started_at, run.snapshot_id) == (row["started_at"].isoformat(), row["snapshot_id"])
        assert run.committed_at == row["created_at"].isoformat()
        assert json.dumps(run.config, sort_keys=True, separators=(",", ":")) == row["config"]
        if row["stage"] != "annotation":
            assert (f"code={run.code}", f"config={run.config_hash}") == (row["code_part"], row["config_part"])
            assert run.seed == 0
        assert list(run.degradations) == row["degradations"]
    assert settings_of(found["capture"]) == ()
    told = settings_of(found["navigation"]) or ()
    assert {text.split("=")[0] for text in told} == {"train_episodes", "test_episodes"}


def test_the_graph_holds_together_and_is_what_its_schema_says(lake: Lake) -> None:
    validator = jsonschema.Draft202012Validator(SCHEMA)
    validator.check_schema(SCHEMA)
    asset = sql(lake, "SELECT asset_id FROM placements ORDER BY 1 LIMIT 1")[0]["asset_id"]
    blob = sql(lake, "SELECT view_blob FROM instances WHERE view_blob IS NOT NULL ORDER BY 1 LIMIT 1")[0]["view_blob"]
    mesh = sql(lake, "SELECT mesh_blob FROM scenes")[0]["mesh_blob"]
    asked = [SCENE, "scene0000_00", asset, f"{asset}.glb", blob, mesh, "usd/scannet_scene0000_00/scene.usda"]
    for what in (*asked, *(f"{SCENE}/{instance}" for instance in objects(lake))):
        lineage = explain(lake, what)
        document = json.loads(json.dumps(lineage.document(), allow_nan=False))
        assert list(validator.iter_errors(document)) == []
        assert lineage.problems == (), what
        ids = {node["id"] for node in document["nodes"]}
        assert len(ids) == len(document["nodes"])
        assert all(edge["source"] in ids and edge["target"] in ids for edge in document["edges"])
        assert {node["run"] for node in document["nodes"]} - {None} <= {run["id"] for run in document["runs"]}
        reached, near = {lineage.target}, [lineage.target]
        while near:
            here = near.pop()
            beside = {e.target for e in lineage.edges if e.source == here} | {e.source for e in lineage.edges if e.target == here}
            near += beside - reached
            reached |= beside
        assert reached == set(lineage.nodes), what
        said = outline(lineage, settings_of)
        assert {node for _, _, node in lineage.outline} | {lineage.target} <= set(lineage.nodes)
        assert max(map(len, said.splitlines())) <= 180
        assert explain(lake, what).document() == lineage.document()


def test_a_scene_counts_what_sql_counts(lake: Lake) -> None:
    lineage = explain(lake, SCENE)
    stages = {node.facts["stage"]: node.facts for node in lineage.of_kind("stage")}
    assert len(stages) == 9
    for stage, name in (("capture", "masks"), ("captions", "captions"), ("candidates", "candidates"), ("navigation", "episodes")):
        assert stages[stage][name] == sql(lake, f"SELECT count(*) AS n FROM {name}")[0]["n"]
    upstream = sql(lake, "SELECT stage, unnest(upstream) AS part FROM current_runs WHERE scene_id = ?", SCENE)
    links = {(e.source, e.target) for e in lineage.edges if e.role == "read" and e.target.startswith("stage:")}
    assert links == {(f"stage:{SCENE}/{row['stage']}", f"stage:{SCENE}/{row['part'].split('=')[0]}") for row in upstream}
    assert [one["instance_id"] for one in stages["optimization"]["objects"]] == objects(lake)
    assert facts_of(lineage, "batch", "batch1")["annotators"] == ["ann", "bob", "cy"]


def test_answers_that_came_after_the_layout_make_it_stale(lake: Lake) -> None:
    (instance,) = {row["instance_id"] for row in sql(lake, "SELECT * FROM annotations")}
    said = []
    for row in lake.snapshot().snapshots:
        reader = lake.snapshot(row.snapshot_id)
        answers = reader.arrow("annotations").num_rows
        origins = {one.origin for one in reader.rows(Placement) if one.instance_id == instance}
        problems = explain(lake, f"{SCENE}/{instance}", row.snapshot_id).problems
        said.append((answers > 0, origins, [problem.kind for problem in problems]))
    assert (False, {"selection"}, []) in said
    assert (True, {"selection"}, ["stale"]) in said
    assert said[-1] == (True, {"annotation"}, [])


def test_an_older_snapshot_is_explained_as_it_was(lake: Lake) -> None:
    (first, *_, last) = (row.snapshot_id for row in lake.snapshot().snapshots)
    instance = next(row["instance_id"] for row in sql(lake, "SELECT * FROM placements WHERE origin = 'annotation'"))
    then, now = (explain(lake, f"{SCENE}/{instance}", snapshot) for snapshot in (first, last))
    assert then.problems == ()
    assert [n.facts["origin"] for n in then.of_kind("placement")] == ["selection"]
    assert [n.facts["origin"] for n in now.of_kind("placement")] == ["annotation"]
    assert then.snapshot.snapshot_id == first


DAMAGE = {
    "scenes": "true", "frames": "frame_id IN (SELECT frame_id FROM masks)", "masks": "true", "instances": "instance_id = ?",
    "captions": "instance_id = ?", "candidates": "instance_id = ?", "assets": "asset_id IN (SELECT asset_id FROM placements)",
    "selections": "instance_id = ? AND rank = 1", "annotations": "choice IS NOT NULL", "supports": "instance_id = ?",
    "certificates": "instance_id = ?", "optimization_steps": "step = 0", "export_files": "role = 'scene'", "export_checks": "true",
}  # fmt: skip
"""Rows of which one is taken away, by table."""


def without(lake: Path, table: str, row: dict[str, Any]) -> None:
    """Take a row out of a table behind the lake's back: the newest snapshot names a version that lacks it."""
    from deltalake import DeltaTable, write_deltalake

    opened = DeltaTable(str(lake / "tables" / table))
    data = opened.to_pyarrow_table()
    kept = [one for one in data.to_pylist() if any(one[name] != value for name, value in row.items())]
    assert len(kept) == data.num_rows - 1
    write_deltalake(opened, type(data).from_pylist(kept, schema=data.schema), mode="overwrite")
    opened.update_incremental()
    snapshots = DeltaTable(str(lake / "tables" / "snapshots"))
    data = snapshots.to_pyarrow_table()
    rows = sorted(data.to_pylist(), key=lambda one: one["snapshot_id"])
    rows[-1]["tables"] = [f"{table}={opened.version()}" if one.split("=")[0] == table else one for one in rows[-1]["tables"]]
    write_deltalake(snapshots, type(data).from_pylist(rows, schema=data.schema), mode="overwrite")


@pytest.mark.parametrize("table", DAMAGE)
def test_a_row_that_is_gone_is_noticed(made: Made, table: str, tmp_path: Path) -> None:
    from schemas.tables import TABLES

    copy = tmp_path / "lake"
    shutil.copytree(made.lake, copy)
    lake = Lake.open(copy)
    origin = "annotation" if table == "annotations" else "selection"
    (carried,) = sql(lake, "SELECT instance_id FROM placements WHERE origin = ? ORDER BY 1 LIMIT 1", origin)
    instance = carried["instance_id"]
    values = [instance] if "?" in DAMAGE[table] else []
    (key,) = sql(lake, f"SELECT {', '.join(TABLES[table].key)} FROM {table} WHERE {DAMAGE[table]} ORDER BY ALL LIMIT 1", *values)
    without(copy, table, key)
    if table == "instances":
        with pytest.raises(InputError, match=f"no instance {instance}"):
            explain(lake, f"{SCENE}/{instance}")
        assert any(problem.kind == "missing" for problem in explain(lake, SCENE).problems)
        return
    if table == "scenes":
        with pytest.raises(InputError, match="nothing that is called"):
            explain(lake, f"{SCENE}/{instance}")
        return
    asked = [f"{SCENE}/{one}" for one in objects(lake)] + [SCENE]
    found = {problem for what in asked for problem in explain(lake, what).problems}
    assert found, f"{table}: {key} is gone, and nothing is said"
    assert all("\n" not in problem.text for problem in found)
    if table == "candidates":
        said = metascenes(made.environment, "explain", SCENE, "--lake", copy)
        assert said.returncode == 1, said.stderr
        assert "not hold" in said.stdout


def test_a_blob_that_is_gone_is_noticed(made: Made, tmp_path: Path) -> None:
    copy = tmp_path / "lake"
    shutil.copytree(made.lake, copy)
    lake = Lake.open(copy)
    row = sql(lake, "SELECT instance_id, asset_id FROM placements ORDER BY 1 LIMIT 1")[0]
    lake.blobs.path(f"{row['asset_id']}.glb").unlink()
    for what in (f"{SCENE}/{row['instance_id']}", row["asset_id"], f"{row['asset_id']}.glb"):
        assert {problem.kind for problem in explain(Lake.open(copy), what).problems} == {"missing"}


def test_exported_files_are_held_against_the_lake(made: Made, lake: Lake, tmp_path: Path) -> None:
    for row in sql(
        lake, "SELECT format, path, role FROM export_files WHERE format NOT IN ('urdf', 'sdf') OR role IN ('scene', 'object') ORDER BY ALL"
    ):
        lineage = explain(lake, str(made.exported / row["format"] / row["path"]))
        facts = lineage.nodes[lineage.target].facts
        assert (facts["format"], facts["role"], facts["content"]) == (row["format"], row["role"], "as in the lake")
        assert lineage.problems == ()
    scene = made.exported / "usd" / "scannet_scene0000_00" / "scene.usda"
    held = explain(lake, str(scene))
    assert len(targets(held, held.target, "holds")) == len(objects(lake))
    copy = tmp_path / "usd" / "scannet_scene0000_00" / "scene.usda"
    copy.parent.mkdir(parents=True)
    copy.write_bytes(scene.read_bytes().replace(b"box", b"bin"))
    (problem,) = explain(lake, str(copy)).problems
    assert problem.kind == "differs"
    with pytest.raises(InputError, match="nothing that is called"):
        explain(lake, str(made.exported / "habitat" / "README.md"))


def test_a_scene_of_a_release_says_so(made: Made, tmp_path: Path) -> None:
    shutil.copytree(made.lake, tmp_path / "lake")
    lake = Lake.open(tmp_path / "lake")
    make_release(lake, "v1")
    write_exports(lake, tmp_path / "out", ("usd",), release="v1")
    lineage = explain(lake, str(tmp_path / "out" / "usd" / "scannet_scene0000_00" / "scene.usda"))
    assert lineage.problems == ()
    assert "release v1" in lineage.nodes[lineage.target].facts["content"]
    assert lineage.releases == ("v1",)


def test_prims_lead_to_the_objects_that_usd_says(made: Made, lake: Lake) -> None:
    from pxr import Usd

    scene = made.exported / "usd" / "scannet_scene0000_00" / "scene.usda"
    stage = Usd.Stage.Open(str(scene))
    seen = set()
    for prim in stage.Traverse():
        said = prim.GetCustomData().get("metascenes", {})
        if "instance_id" not in said:
            continue
        seen.add(said["instance_id"])
        inside = next(iter(prim.GetAllChildren()))
        for name in (prim.GetPath(), inside.GetPath()):
            lineage = explain(lake, f"{scene}:{name}")
            assert lineage.nodes[lineage.target].facts["name"] == str(prim.GetPath())
            assert lineage.problems == ()
            assert targets(lineage, lineage.target, "shows") >= {f"instance:{SCENE}/{said['instance_id']}"}
        with pytest.raises(InputError, match="no such prim"):
            explain(lake, f"{scene}:{prim.GetPath()}/Nothing")
    assert sorted(seen) == objects(lake)
    with pytest.raises(InputError, match="is nothing that this export places"):
        explain(lake, f"{scene}:/World/Room")


texts = st.text(st.characters(codec="utf-8", exclude_characters="\x00\r", exclude_categories=("Cs",)), min_size=1, max_size=30)


@given(st.lists(st.tuples(texts | st.sampled_from(['"', "'", "'\"", '"""', 'def "x" (', "{", "}\n)", "@a@", "# no"]), texts), max_size=4))
@settings(deadline=None)
def test_usd_layers_are_read_as_openusd_reads_them(said: list[tuple[str, str]]) -> None:
    from pxr import Sdf

    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.customLayerData = {"metascenes": {"scene_id": "a/b", "instance_id": "of no prim"}}
    world = Sdf.PrimSpec(layer, "World", Sdf.SpecifierDef, "Xform")
    for index, (asset, note) in enumerate(said):
        prim = Sdf.PrimSpec(world, f"thing_{index}", Sdf.SpecifierOver if index % 2 else Sdf.SpecifierDef)
        prim.customData = {"other": {"instance_id": note}, "metascenes": {"instance_id": note, "asset_id": asset, "scene_id": "a/b"}}
        prim.comment = note
        Sdf.AttributeSpec(prim, "def", Sdf.ValueTypeNames.String).default = asset
        Sdf.PrimSpec(prim, "inner", Sdf.SpecifierDef)
    again = Sdf.Layer.CreateAnonymous(".usda")
    text = layer.ExportToString()
    again.ImportFromString(text)
    expected = []
    for prim in again.GetPrimAtPath("/World").nameChildren:
        facts = prim.customData["metascenes"]
        expected.append((str(prim.path), facts["instance_id"], facts["asset_id"]))
    assert [(one.name, one.instance_id, one.asset_id) for one in places("usd", "scene.usda", text.encode())] == expected


@pytest.mark.parametrize("format", ["usd", "mjcf", "urdf", "habitat", "glb", "nav2", "sdf"])
@given(st.binary(max_size=60))
@settings(deadline=None, max_examples=30)
def test_what_is_no_exported_scene_is_refused_in_one_line(format: str, data: bytes) -> None:
    with contextlib.suppress(InputError):
        assert places(format, "file", data) == []


@pytest.mark.parametrize(
    ("origin", "displacement_m", "who"),
    [("annotation", 0.125, "annotators of the imported dataset"), ("imported", None, "the imported dataset")],
)
def test_an_object_of_others_has_fewer_links(tmp_path: Path, origin: str, displacement_m: float | None, who: str) -> None:
    """Placements as imports write them: of MetaScenes people chose the assets, of Habitat nobody says."""
    lake = Lake.open(tmp_path / "lake")
    blob = lake.blobs.put(b"glTF", "glb")
    asset = sample(Asset, asset_id=blob.split(".")[0], mesh_blob=blob, provider="imported")
    of = {"scene_id": "others/room_1", "instance_id": "0007"}
    pose = tuple(float(i % 5 == 0) for i in range(16))
    instance = sample(Instance, **of, box_pose=pose, points_blob=lake.blobs.put(b"ply", "ply"), best_frames=())
    placement = sample(
        Placement, **of, origin=origin, annotator=None, annotation_match=None, method="imported", asset_id=asset.asset_id,
        proposed_pose=pose, optimized_pose=pose, displacement_m=displacement_m, lift_m=displacement_m,
    )  # fmt: skip
    offer = sample(Candidate, **of, slot=1, provider="imported", outcome="filled", asset_id=asset.asset_id)
    scene = sample(Scene, scene_id="others/room_1", scan="room_1", mesh_blob=blob)
    rows = {
        "capture": {"scenes": [scene], "shells": [], "frames": [], "instances": [instance], "masks": []},
        "candidates": {"candidates": [offer], "assets": [asset]},
        "optimization": {"placements": [placement], "supports": [], "contacts": [], "optimization_steps": [], "optimizations": [],
                         "certificates": []},
    }  # fmt: skip
    above: list[str] = []
    for stage, tables in rows.items():
        print_ = fingerprint("others", stage)
        lake.stage_rows(stage_run("others/room_1", stage, print_, *above), tables)
        above.append(f"{stage}={print_}")
    lake.commit()
    lineage = explain(lake, "room_1/0007")
    assert lineage.problems == ()
    assert {node.kind for node in lineage.nodes.values()} == {"instance", "placement", "candidate", "provider", "asset", "scene", "scan"}
    said = outline(lineage, settings_of)
    assert "code not recorded" in said
    assert "settings: not recorded" in said
    assert f"proposed by {who}  [" in said
    assert ("0.125 m aside" in said) == (displacement_m is not None)
    assert "overlaps not recorded" in said, "nobody looked for overlaps"
    assert "hash of its files not recorded" in said
    of_scene = explain(lake, "others/room_1")
    assert of_scene.problems == ()
    assert f"asset {asset.asset_id[:12]} by {who}\n" in outline(of_scene, settings_of)
    assert explain(lake, asset.asset_id).problems == ()
    for ending in FORMATS:
        assert draw_lineage(lineage, ending)


@pytest.mark.slow
def test_pictures_open_and_hold_every_node(lake: Lake, tmp_path: Path) -> None:
    from PIL import Image

    for what in (SCENE, *(f"{SCENE}/{instance}" for instance in objects(lake))):
        lineage = explain(lake, what)
        svg, png = draw_lineage(lineage, ".svg"), draw_lineage(lineage, ".png")
        assert (svg, png) == (draw_lineage(lineage, ".svg"), draw_lineage(explain(lake, what), ".png"))
        root = ElementTree.fromstring(svg.decode())
        assert {e.get("id") for e in root.iter("{http://www.w3.org/2000/svg}g")} >= set(lineage.nodes)
        shown = " ".join("".join(e.itertext()) for e in root.iter("{http://www.w3.org/2000/svg}text"))
        assert all(node.kind.replace("_", " ") in shown for node in lineage.nodes.values())
        image = Image.open(io.BytesIO(png))
        image.load()
        assert image.getpixel((2, 2))[:3] == (255, 255, 255)
        assert image.width > 1000


def command(made: Made, *arguments: object) -> subprocess.CompletedProcess[str]:
    return metascenes(made.environment, "explain", "--lake", made.lake, *arguments)


def test_the_command_prints_text_json_and_a_picture(made: Made, tmp_path: Path) -> None:
    instance = objects(Lake.open(made.lake))[0]
    said = command(made, f"{SCENE}/{instance}", "--picture", tmp_path / "deep" / "a.svg")
    assert said.returncode == 0, said.stderr
    assert "every id leads to a row" in said.stdout
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["a.svg"]
    printed = command(made, f"{SCENE}/{instance}", "--json")
    assert printed.returncode == 0
    assert json.loads(printed.stdout) == json.loads(json.dumps(explain(Lake.open(made.lake), f"{SCENE}/{instance}").document()))
    assert "Example: metascenes explain" in metascenes(made.environment, "explain", "--help").stdout
    refused = command(made, SCENE, "--picture", tmp_path / "a.bmp")
    assert (refused.returncode, len(refused.stderr.splitlines())) == (2, 1)


WRONG = [
    "x'; DROP TABLE scenes; --",
    f"{SCENE}'/0007",
    f"{SCENE}/9999",
    "nobody/nothing",
    "0" * 64,
    "0" * 64 + ".glb",
    "\n",
    "a:b:/c",
    "usd/x.usda",
]


@pytest.mark.parametrize("asked", WRONG)
def test_what_is_not_there_is_said_in_one_line(lake: Lake, asked: str) -> None:
    with pytest.raises(InputError) as caught:
        explain(lake, asked)
    assert "\n" not in str(caught.value)


@given(st.text(max_size=40))
@settings(deadline=None, max_examples=25)
def test_whatever_else_is_asked_is_refused_in_one_line(made: Made, asked: str) -> None:
    with pytest.raises(InputError) as caught:
        explain(Lake.open(made.lake), asked)
    assert "\n" not in str(caught.value)


def test_a_name_that_two_datasets_have_must_be_told_apart(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    blob = lake.blobs.put(b"glTF", "glb")
    for dataset in ("one", "two"):
        scene = sample(Scene, scene_id=f"{dataset}/room", scan="room", mesh_blob=blob)
        run = stage_run(f"{dataset}/room", "capture", fingerprint(dataset))
        lake.stage_rows(run, {"scenes": [scene], "shells": [], "frames": [], "instances": [], "masks": []})
    lake.commit()
    with pytest.raises(InputError, match="may be of one/room, two/room"):
        explain(lake, "room")
    assert explain(lake, "two/room").target == "scene:two/room"
