"""Exports of what may be shipped: nothing of what may not is in any file, and the rest is as it was."""

from __future__ import annotations

import dataclasses
import gzip
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flows.cli import cli
from flows.outputs.export import WrittenExports, write_exports
from flows.outputs.shipment import shipment
from schemas.candidates import Asset, Candidate
from schemas.exports import ExportFile
from schemas.families.export_formats import EXPORT_FORMATS
from schemas.optimization import Placement
from tasks import exports
from tasks.geometry.meshes import load_glb
from tasks.geometry.transforms import translation, yaw_pose
from tasks.stage import Context
from tests.flows.outputs.test_export_folder import contents
from tests.replicas import Object, cube, furnished, obj, rows_of, with_navigation
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake
from warehouse.release import make_release
from warehouse.release.licenses import Allowed

pytestmark = pytest.mark.whole

PLAIN, MIXED, CLOSED, MUTE = "demo/plain", "demo/mixed", "demo/closed", "demo/mute"
SCANS = {PLAIN: "CC0-1.0", MIXED: "CC0-1.0", CLOSED: "Terms of a scanner", MUTE: None}
ASSETS = {"table": "CC-BY-4.0", "chair": "CC-BY-NC-4.0", "picture": "unknown", "box": "MIT OR GPL-3.0-only", "stool": "Apache-2.0"}
"""License of every asset, by category."""

WITHOUT_CHAIRS = Allowed(("cc0-1.0", "MIT", "CC-BY-*", "Apache-2.0", "unknown"))
WITHOUT_TABLE = Allowed(("CC0-1.0", "MIT", "CC-BY-NC-4.0", "Apache-2.0", "unknown"))


def stage(lake: Lake, scene: str, objects: list[Object], formats: tuple[str, ...], with_episodes: bool = False) -> None:
    """Stage a scene and its exports."""
    rows, blobs = rows_of(objects, scene)
    rows["scenes"] = [dataclasses.replace(row, license=SCANS[scene]) for row in rows["scenes"]]
    rows["assets"] = [dataclasses.replace(row, license=ASSETS[row.category], author="A. Maker") for row in rows["assets"]]
    rows |= {"navmeshes": [], "episodes": []}
    found: dict[str, bytes] = dict(blobs)
    if with_episodes:
        rows, found = with_navigation(rows, blobs)
    config = exports.ExportsConfig(formats=formats)
    caches = {name: {} for name in ("tasks.geometry.pieces",)}
    context = Context(scene, "exports", 0, found, caches)
    outcome = exports.run(**{table: rows[table] for table in exports.STAGE.reads}, context=context, config=config)
    for name, data in {**found, **outcome.blobs}.items():
        lake.blobs.put(data, name.split(".")[1])
    rows["candidates"] = [
        sample(Candidate, scene_id=scene, instance_id=row.instance_id, slot=1, asset_id=row.asset_id) for row in rows["placements"]
    ]
    from flows.run.fingerprints import canonical_json

    above: list[str] = []
    told = {"capture": ("scenes", "shells", "instances"), "captions": ("captions",), "candidates": ("candidates", "assets"),
            "optimization": ("placements", "supports"), "navigation": ("navmeshes", "episodes")}  # fmt: skip
    for at, (name, tables) in enumerate(told.items()):
        print_ = fingerprint(scene, name)
        lake.stage_rows(stage_run(scene, name, print_, *above, at=at), {table: rows[table] for table in tables})
        above.append(f"{name}={print_}")
    run = stage_run(scene, "exports", fingerprint(scene, "exports"), *above, at=9, config=canonical_json(config), reasons=("seed=0",))
    lake.stage_rows(run, {table: outcome.rows[table] for table in exports.STAGE.writes})


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """A scene that may be shipped, one of which some objects may not, one that may not, and one of which nobody knows."""
    lake = Lake.open(tmp_path_factory.mktemp("licensed") / "lake")
    stage(lake, PLAIN, [obj("stool", yaw_pose(0.3, [0.5, 0.0, 0.0]), seed=7)], EXPORT_FORMATS)
    stage(lake, MIXED, furnished(), EXPORT_FORMATS, with_episodes=True)
    for scene in (CLOSED, MUTE):
        stage(lake, scene, [cube((0.3, 0.2, 0.25), translation([0.0, 0.0, 0.0]))], ("glb", "urdf"))
    lake.commit("licensed")
    make_release(lake, "v1")
    return lake


@pytest.fixture(scope="module")
def whole(lake: Lake, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Everything, exported. Read only."""
    out = tmp_path_factory.mktemp("whole")
    assert write_exports(lake, out).findings == ()
    return out


@pytest.fixture(scope="module")
def without_chairs(lake: Lake, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, WrittenExports]:
    out = tmp_path_factory.mktemp("without_chairs")
    return out, write_exports(lake, out, allowed=WITHOUT_CHAIRS)


def opened(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Every file below a folder but the pages, compressed ones as what is in them too."""
    for name, data in contents(folder).items():
        if Path(name).name not in ("LEFT_OUT.md", ".exported"):
            yield name, data
            if name.endswith(".gz"):
                yield name, gzip.decompress(data)


def traces(lake: Lake, category: str) -> dict[str, list[bytes]]:
    """What would give an asset away: its hash, its blob's, its names in exports, and its vertices as GLBs hold them."""
    asset = next(row for row in lake.snapshot().rows(Asset) if row.category == category)
    placed = [row.instance_id for row in lake.snapshot().rows(Placement, MIXED) if row.asset_id == asset.asset_id]
    parts = load_glb(lake.blobs[asset.mesh_blob], "asset")
    vertices = np.concatenate([np.asarray(part.vertices, np.float32) for part in parts])
    return {
        "hashes": [asset.asset_id.encode(), asset.mesh_blob.split(".")[0].encode()],
        "names": [f"{category}_{name}".encode() for name in placed],
        "geometry": [vertices[i : i + 2].tobytes() for i in range(0, len(vertices) - 1, max(1, len(vertices) // 8))],
    }


@pytest.mark.slow
def test_nothing_of_what_is_left_out_is_in_any_file(lake: Lake, whole: Path, without_chairs) -> None:
    category = "chair"
    out, written = without_chairs
    for kind, marks in traces(lake, category).items():
        assert any(mark in data for mark in marks for _, data in opened(whole)), f"{kind} would be found where they are"
        found = [(name, mark) for name, data in opened(out) for mark in marks if mark in data]
        assert found == [], kind
    of_it = {data for name, data in contents(whole).items() if category in Path(name).as_posix() and "mixed" in name}
    assert of_it
    assert not of_it & set(contents(out).values())
    assert written.findings == (), "what is left passes every gate"


def test_the_rest_is_as_it_was(lake: Lake, whole: Path, without_chairs) -> None:
    out, _ = without_chairs
    before, after = contents(whole), contents(out)
    pages = {name for name in after if Path(name).name in ("LEFT_OUT.md", "ATTRIBUTION.md", ".exported")}
    assert {Path(name).name for name in pages} == {"LEFT_OUT.md", "ATTRIBUTION.md", ".exported"}
    assert after.keys() - pages <= before.keys()
    plain = {name for name in before if "plain" in name}
    assert plain
    assert {name: after[name] for name in plain if "metascenes." not in name} == {
        name: before[name] for name in plain if "metascenes." not in name
    }
    for part in ("urdf/demo_mixed/table_0001", "urdf/demo_mixed/picture_0006", "urdf/demo_mixed/box_0004"):
        kept = {name: data for name, data in before.items() if part in name}
        assert kept, part
        assert {name: after.get(name) for name in kept} == kept
    assert not [name for name in after if "closed" in name], "its scan may not be shipped"
    assert [name for name in after if "mute" in name], "`unknown` is allowed"


def test_scenes_hold_what_is_kept_and_episodes_lead_to_it(lake: Lake, whole: Path, without_chairs) -> None:
    import mujoco

    out, written = without_chairs
    assert written.shipment is not None
    gone = {one.instance_id for one in written.shipment.left_out if one.scene_id == MIXED}
    assert gone == {"0002", "0003"}
    model = mujoco.MjModel.from_xml_path(str(out / "mjcf" / "demo_mixed" / "scene.xml"))
    bodies = {model.body(i).name for i in range(model.nbody)}
    assert {name[-4:] for name in bodies if name[-4:].isdigit()} == {"0001", "0004", "0005", "0006"}

    def targets(folder: Path) -> dict[str, str]:
        found = {}
        for file in sorted((folder / "habitat" / "objectnav").rglob("content/*.json.gz")):
            for episode in json.loads(gzip.decompress(file.read_bytes()))["episodes"]:
                found[episode["info"]["episode"]] = episode["info"]["target_object_id"][-4:]
        return found

    before = targets(whole)
    assert set(before.values()) & gone, "some led to the chairs"
    assert targets(out) == {name: target for name, target in before.items() if target not in gone}
    assert written.shipment.episodes == sum(target in gone for target in before.values())


def test_what_stands_on_an_object_goes_with_it(lake: Lake, tmp_path: Path) -> None:
    written = write_exports(lake, tmp_path, ("glb", "mjcf"), allowed=WITHOUT_TABLE)
    assert written.findings == ()
    assert written.shipment is not None
    reasons = {one.instance_id: one.reason for one in written.shipment.left_out if one.scene_id == MIXED}
    assert reasons.keys() == {"0001", "0004"}
    assert reasons["0004"] == "stood on or in 0001, which is left out"
    page = (tmp_path / "glb" / "LEFT_OUT.md").read_text()
    assert "| demo/mixed/0001 | table | CC-BY-4.0 |" in page
    assert "| demo/mixed/0004 | box |" in page
    assert "| demo/closed | scan of demo | Terms of a scanner |" in page
    credits = (tmp_path / "glb" / "ATTRIBUTION.md").read_text()
    assert "CC-BY-NC-4.0" in credits
    assert "A. Maker" in credits
    assert "| CC-BY-4.0" not in credits
    assert "scanner" not in credits


@pytest.mark.parametrize(
    ("names", "scenes", "barred"),
    [
        (("CC0-1.0", "Apache-2.0"), (PLAIN,), {CLOSED, MUTE, MIXED}),
        (("Apache-2.0",), (), {PLAIN, CLOSED, MUTE, MIXED}),
        (("CC0-1.0", "Apache-2.0", "terms of a scanner", "MIT"), (CLOSED, MIXED, PLAIN), {MUTE}),
        (("CC0-1.0", "Apache-2.0", "unknown", "GPL-3.0-only"), (MIXED, MUTE, PLAIN), {CLOSED}),
    ],
)
def test_scenes_go_by_their_scans_and_by_what_is_left_of_them(
    lake: Lake, names: tuple[str, ...], scenes: tuple[str, ...], barred: set[str]
) -> None:
    sent = shipment(lake.snapshot(), sorted(SCANS), Allowed(names))
    assert set(sent.scenes) == set(scenes)
    assert {one.scene_id for one in sent.left_out if one.instance_id is None} == barred
    assert not {one.scene_id for one in sent.left_out} & (set(sent.scenes) - sent.kept.keys())


def test_where_nothing_may_be_shipped_an_older_export_does_not_stay(lake: Lake, tmp_path: Path) -> None:
    write_exports(lake, tmp_path, ("habitat", "glb"))
    written = write_exports(lake, tmp_path, ("habitat", "glb"), allowed=Allowed(("0BSD",)))
    assert (written.files, written.findings, written.usd_scenes) == (0, (), ())
    assert set(contents(tmp_path)) == {
        f"{format_}/{page}" for format_ in ("habitat", "glb") for page in ("LEFT_OUT.md", "ATTRIBUTION.md", ".exported")
    }
    write_exports(lake, tmp_path, ("glb",))
    assert not (tmp_path / "glb" / "LEFT_OUT.md").exists()


def test_the_command_says_what_is_left_out_before_and_after(lake: Lake, tmp_path: Path, without_chairs) -> None:
    out, written = without_chairs
    assert written.shipment is not None
    ask = ["export", "--lake", lake.address, "--out", str(tmp_path / "out"), "--release", "v1", "--json", "--workers", "2"]
    for name in WITHOUT_CHAIRS.names[:3]:
        ask += ["--license-allow", name]
    ask += ["--licence-allow", ",".join(WITHOUT_CHAIRS.names[3:])]
    dry = CliRunner().invoke(cli, [*ask, "--dry-run"])
    assert dry.exit_code == 0, dry.exception
    assert not (tmp_path / "out").exists()
    done = CliRunner().invoke(cli, ask)
    assert done.exit_code == 0, done.exception
    told = json.loads(done.output)
    assert told["left_out"] == json.loads(dry.output)["left_out"] == json.loads(json.dumps(written.shipment.as_json()))
    assert {row["instance_id"] for row in told["left_out"]["objects"]} == {"0002", "0003"}
    assert {row["scene_id"] for row in told["left_out"]["scenes"]} == {CLOSED}
    first, second = contents(out), contents(tmp_path / "out")
    assert first.keys() == second.keys()
    assert {name for name in first if first[name] != second[name]} == {name for name in first if name.endswith("/scene.usda")}, (
        "the release"
    )


def test_assets_cut_from_a_scan_go_by_the_license_of_that_scan(lake: Lake, tmp_path: Path) -> None:
    from shutil import copytree

    copytree(lake.address, tmp_path / "lake")
    other = Lake.open(tmp_path / "lake")
    reader = other.snapshot()
    rows = {table: reader.rows(sample_of, PLAIN) for table, sample_of in (("candidates", Candidate),)}
    assets = [
        dataclasses.replace(row, license="LicenseRef-scan", source=f"scan {CLOSED}")
        for row in reader.rows(Asset)
        if row.category == "stool"
    ]
    print_ = fingerprint(PLAIN, "cut")
    above = f"capture={fingerprint(PLAIN, 'capture')}"
    other.stage_rows(
        stage_run(PLAIN, "candidates", print_, above, f"captions={fingerprint(PLAIN, 'captions')}", at=50), rows | {"assets": assets}
    )
    placed = {"placements": reader.rows(Placement, PLAIN), "supports": []}
    other.stage_rows(stage_run(PLAIN, "optimization", fingerprint(PLAIN, "again"), f"candidates={print_}", at=51), placed)
    files = {"export_files": reader.rows(ExportFile, PLAIN), "export_checks": []}
    above = f"optimization={fingerprint(PLAIN, 'again')}"
    other.stage_rows(stage_run(PLAIN, "exports", fingerprint(PLAIN, "more"), above, at=52), files)
    other.commit()
    without = shipment(other.snapshot(), [PLAIN], Allowed(("CC0-1.0", "LicenseRef-scan")))
    assert without.scenes == ()
    assert {one.license for one in without.left_out if one.instance_id} == {"Terms of a scanner"}
    assert shipment(other.snapshot(), [PLAIN], Allowed(("CC0-1.0", "Terms of a Scanner"))).left_out == ()
