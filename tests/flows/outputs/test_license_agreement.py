"""One truth of licenses: views, data card, attributions, `--license-allow` and every export format say the same of an asset."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from flows.outputs.export import write_exports
from flows.outputs.shipment import shipment
from flows.run.fingerprints import canonical_json
from flows.worker import Job, execute
from schemas.candidates import Candidate
from schemas.families.export_formats import EXPORT_FORMATS
from schemas.lineage.licenses import OF_THE_SCAN
from schemas.optimization import Placement
from tasks import exports
from tasks.exports import bodies
from tasks.geometry.transforms import translation
from tests.flows.outputs.test_export_licenses import opened
from tests.replicas import Object, cube, obj, rows_of
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake
from warehouse.release import make_release
from warehouse.release.attribution import attribution_of
from warehouse.release.licenses import Allowed

pytestmark = pytest.mark.whole

STATED, MUTE = "demo/stated", "demo/mute"
SCANS = {STATED: "Terms of a scanner", MUTE: None}
"""License of every scan; of one there is no license file."""

HELD = {
    "table": "Terms of a scanner", "box": "unknown", "stool": "unknown", "bench": "unknown", "mug": "CC-BY-4.0",
    "crate": "(MIT OR CC0-1.0) AND Terms of a scanner", "basket": "CC-BY-4.0 AND unknown",
}  # fmt: skip
"""What holds for the asset of every category."""


def room(seed: int) -> list[Object]:
    """Seven objects, of which no two in any room are one asset."""
    size = 0.01 * seed
    return [
        obj("table", translation([-1.5, 0.5, 0.0]), seed=3 + seed),
        dataclasses.replace(cube((0.3 + size, 0.2, 0.25), translation([0.0, -1.0, 0.0])), category="box"),
        obj("stool", translation([1.2, -1.0, 0.0]), seed=7 + seed),
        dataclasses.replace(cube((0.6 + size, 0.3, 0.4), translation([-1.5, -1.2, 0.0])), category="bench"),
        dataclasses.replace(cube((0.1 + size, 0.1, 0.12), translation([2.2, -1.2, 0.0])), category="mug"),
        dataclasses.replace(cube((0.31 + size, 0.3, 0.2), translation([0.5, 0.9, 0.0])), category="crate"),
        dataclasses.replace(cube((0.21 + size, 0.3, 0.2), translation([1.3, 0.6, 0.0])), category="basket"),
    ]


def told(category: str) -> tuple[str, str]:
    """License and source of an asset, as the lake has them: cut from either scan, from one that is gone, nobody's, somebody's, and
    somebody's that was painted with either scan."""
    return {
        "table": (OF_THE_SCAN, f"scan {STATED}"), "box": (OF_THE_SCAN, f"scan {MUTE}"), "stool": (OF_THE_SCAN, "scan demo/gone"),
        "bench": ("NOASSERTION", "library/bench.glb"), "mug": ("CC-BY-4.0", "library/mug.glb"),
        "crate": (f"(MIT OR CC0-1.0) AND {OF_THE_SCAN}", f"scan {STATED}; library/crate.glb"),
        "basket": (f"CC-BY-4.0 AND {OF_THE_SCAN}", f"scan {MUTE}; library/basket.glb"),
    }[category]  # fmt: skip


def lay(lake: Lake, scene: str, seed: int) -> tuple[str, ...]:
    """Commit a scene up to its layout; what its exports are made from. Both scenes show assets that were cut from either scan."""
    rows, blobs = rows_of(room(seed), scene)
    for name, data in blobs.items():
        lake.blobs.put(data, name.split(".")[1])
    rows["scenes"] = [dataclasses.replace(row, license=SCANS[scene]) for row in rows["scenes"]]
    rows["assets"] = [
        dataclasses.replace(row, license=told(row.category)[0], source=told(row.category)[1], provider="scan_crop")
        for row in rows["assets"]
    ]
    rows["candidates"] = [
        sample(Candidate, scene_id=scene, instance_id=row.instance_id, slot=1, asset_id=row.asset_id) for row in rows["placements"]
    ]
    rows |= {"navmeshes": [], "episodes": []}
    above: list[str] = []
    stages = {"capture": ("scenes", "shells", "instances"), "captions": ("captions",), "candidates": ("candidates", "assets"),
              "optimization": ("placements", "supports"), "navigation": ("navmeshes", "episodes")}  # fmt: skip
    for at, (name, tables) in enumerate(stages.items()):
        print_ = fingerprint(scene, name)
        lake.stage_rows(stage_run(scene, name, print_, *above, at=at), {table: rows[table] for table in tables})
        above.append(f"{name}={print_}")
    return tuple(above)


def make(lake: Lake, scene: str, above: tuple[str, ...]) -> None:
    """Export a scene as a run does."""
    config = exports.ExportsConfig()
    print_ = fingerprint(scene, "exports")
    run = execute(Job(lake.address, scene, "exports", config, canonical_json(config), 0, print_, ("seed=0",), above, 1))
    assert run.error is None


def built(folder: Path) -> Lake:
    """A lake of both scenes."""
    lake = Lake.open(folder)
    above = {scene: lay(lake, scene, seed) for seed, scene in enumerate(SCANS)}
    lake.commit("layouts")
    for scene in SCANS:
        make(lake, scene, above[scene])
    lake.commit("exports")
    return lake


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """Read only."""
    return built(tmp_path_factory.mktemp("agreement") / "lake")


@pytest.fixture(scope="module")
def out(lake: Lake, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All formats. Read only."""
    out = tmp_path_factory.mktemp("shipped")
    assert write_exports(lake, out).findings == ()
    return out


def expected(lake: Lake) -> dict[str, str]:
    """What holds, by asset."""
    with lake.snapshot().connect() as connection:
        rows = connection.execute("SELECT asset_id, category FROM assets").fetchall()
    assert len(rows) == 2 * len(HELD)
    return {asset: HELD[category] for asset, category in rows}


def said_in_usd(folder: Path) -> list[dict[str, Any]]:
    from pxr import Usd

    found = []
    for path in folder.glob("*/scene.usda"):
        stage = Usd.Stage.Open(str(path))  # a prim lives no longer than its stage
        for prim in stage.TraverseAll():
            about = prim.GetCustomDataByKey("metascenes") or {}
            if "asset_id" in about:
                found.append(about)
    return found


def said_in_mjcf(folder: Path) -> list[dict[str, Any]]:
    texts = [text.get("data") for path in folder.glob("*/scene.xml") for text in ElementTree.parse(path).iter("text")]
    return [about for text in texts if "asset_id" in (about := json.loads(text or "{}"))]


def said_in_urdf(folder: Path) -> list[dict[str, Any]]:
    return [about for path in folder.glob("*/poses.json") for about in json.loads(path.read_text())["objects"]]


def said_in_glb(folder: Path) -> list[dict[str, Any]]:
    found = []
    for path in folder.glob("*.glb"):
        data = path.read_bytes()
        document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
        found += [node["extras"] for node in document["nodes"] if "asset_id" in node.get("extras", {})]
    return found


def said_in_habitat(folder: Path) -> list[dict[str, Any]]:
    rows = list(csv.DictReader(io.StringIO((folder / "metadata" / "attribution.csv").read_text())))
    for path in (folder / "scenes").glob("*.json"):
        rows += [item["user_defined"] for item in json.loads(path.read_text())["object_instances"]]
    return rows


def said_in_nav2(folder: Path) -> list[dict[str, Any]]:
    return [about for path in folder.glob("*/objects.json") for about in json.loads(path.read_text())["objects"]]


def said_in_sdf(folder: Path) -> list[dict[str, Any]]:
    texts = [element.text for path in folder.glob("*/world.sdf") for element in ElementTree.parse(path).iter("{urn:metascenes}about")]
    return [about for text in texts if "asset_id" in (about := json.loads(text or "{}"))]


READERS = {
    "usd": said_in_usd, "mjcf": said_in_mjcf, "urdf": said_in_urdf, "glb": said_in_glb, "habitat": said_in_habitat,
    "nav2": said_in_nav2, "sdf": said_in_sdf,
}  # fmt: skip


@pytest.mark.parametrize("format_", EXPORT_FORMATS)
def test_every_format_says_the_license_that_holds(lake: Lake, out: Path, format_: str) -> None:
    said = defaultdict(set)
    for about in READERS[format_](out / format_):
        said[about["asset_id"]].add(about["license"])
    assert said == {asset: {license_} for asset, license_ in expected(lake).items()}
    assert not [name for name, data in opened(out / format_) if OF_THE_SCAN.encode() in data]
    words = b"".join(data for _, data in opened(out / format_))
    assert b"Terms of a scanner" in words


def test_views_say_the_license_that_holds(lake: Lake) -> None:
    held = expected(lake)
    with lake.snapshot().connect() as connection:

        def ask(sql: str) -> list[tuple[Any, ...]]:
            return connection.execute(sql).fetchall()

        assert dict(ask("SELECT asset_id, license FROM asset_licenses")) == held
        placed = Counter((row.scene_id, held[row.asset_id]) for row in lake.snapshot().rows(Placement))
        by_scene = ask("SELECT scene_id, license, items FROM license_by_scene WHERE material = 'asset'")
        assert {(scene, license_): items for scene, license_, items in by_scene} == placed
        assert dict(ask("SELECT scene_id, license FROM license_by_scene WHERE material = 'scan'")) == {
            STATED: "Terms of a scanner",
            MUTE: "unknown",
        }
        assert dict(ask("SELECT license, items FROM license_counts WHERE material = 'asset'")) == Counter(held.values())
        assert dict(ask("SELECT license, items FROM license_counts WHERE material = 'scan'")) == {"Terms of a scanner": 1, "unknown": 1}
        assert dict(ask("SELECT license, sum(assets) FROM attributions GROUP BY license")) == Counter(held.values())
        assert ask("SELECT scene_licenses, asset_licenses FROM dataset_comparison") == [
            (["Terms of a scanner", "unknown"], sorted(set(held.values())))
        ]
        answers = [str(ask(f'SELECT * FROM "{name}"')) for (name,) in ask("SELECT view_name FROM duckdb_views() WHERE NOT internal")
                   if name not in {"assets", "current_runs", "stage_runs"}]  # fmt: skip
        assert not [text for text in answers if OF_THE_SCAN in text], "no question is answered with the word for it"


def test_a_release_says_the_license_that_holds(lake: Lake) -> None:
    held = expected(lake)
    release = make_release(lake, "v1")
    with lake.snapshot(release.snapshot_id).connect() as connection:
        assert sum((Counter({credit.license: credit.items}) for credit in attribution_of(connection).assets), Counter()) == Counter(
            held.values()
        )
    folder = Path(lake.address) / "releases" / "v1"
    for name in ("README.md", "ATTRIBUTION.md"):
        text = (folder / name).read_text()
        assert OF_THE_SCAN not in text
        assert "Terms of a scanner" in text
    for license_, count in Counter(held.values()).items():
        assert f"| assets | {license_} | {count} |" in (folder / "README.md").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("license_", ["Terms of a scanner", "unknown", "CC-BY-4.0", "CC0-1.0"])
def test_what_is_left_out_goes_by_the_license_that_holds(lake: Lake, tmp_path: Path, license_: str) -> None:
    held = expected(lake)
    names = sorted({"Terms of a scanner", "unknown", "CC-BY-4.0", "CC0-1.0"} - {license_})
    sent = shipment(lake.snapshot(), [STATED, MUTE], Allowed(tuple(names)))
    scans_gone = {scene for scene, stated in SCANS.items() if (stated or "unknown") == license_}
    gone = {  # what asks for it, alone or beside others
        (row.scene_id, row.instance_id): held[row.asset_id] for row in lake.snapshot().rows(Placement) if license_ in held[row.asset_id]
    }
    left = {(one.scene_id, one.instance_id): one.license for one in sent.left_out if one.instance_id is not None}
    assert left == {key: value for key, value in gone.items() if key[0] not in scans_gone}
    assert {one.scene_id for one in sent.left_out if one.instance_id is None} == scans_gone
    write_exports(lake, tmp_path, ("glb",), allowed=Allowed(tuple(names)))
    page = (tmp_path / "glb" / "ATTRIBUTION.md").read_text()
    assert OF_THE_SCAN not in page
    assert {name for name in (*names, license_) if f"\n| {name} |" in page} <= set(names)
    said = {about["asset_id"]: about["license"] for about in said_in_glb(tmp_path / "glb")}
    assert said.items() <= held.items()
    assert not [text for text in said.values() if license_ in text]


@pytest.mark.slow
def test_exports_of_an_older_version_are_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(bodies, "licensed", lambda asset, scans: asset)
        patch.setattr("flows.worker.with_licenses_of_scans", lambda assets, *more: assets)
        older = built(tmp_path / "lake")
        scene = next(blob for blob in older.snapshot().rows(exports.ExportFile) if blob.format == "urdf" and blob.role == "scene")
        assert OF_THE_SCAN.encode() in older.blobs[scene.file_blob]
    held = expected(older)
    for allowed in (None, Allowed(tuple(HELD.values()))):
        written = write_exports(older, tmp_path / "out", ("urdf", "usd"), allowed=allowed)
        assert written.findings == ()
        assert {about["asset_id"]: about["license"] for about in said_in_urdf(tmp_path / "out" / "urdf")} == held
        assert not [name for name, data in opened(tmp_path / "out") if OF_THE_SCAN.encode() in data]
