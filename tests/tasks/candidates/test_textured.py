"""Textured twins: the same solid with another skin, painted with what the scan's frames show, or by a program of others."""

from __future__ import annotations

import dataclasses
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.candidates import Asset, Candidate
from tasks.calls.ledger import Recollection
from tasks.candidates import STAGE, CandidatesConfig, SlotConfig
from tasks.candidates.procedural import Procedural
from tasks.candidates.scan_crop import ScanCrop
from tasks.candidates.textured import FramePainting, Textured
from tasks.capture.scan import Scan
from tasks.geometry.meshes import dump_glb, load_glb, material_of, surface_of
from tasks.geometry.proximity import closest_points
from tasks.geometry.rendering import RayScene
from tasks.stage import Outcome
from tasks.texturing.baking import BakeConfig
from tasks.texturing.charts import chart_figures
from tasks.texturing.commanded import TextureCommand
from tasks.texturing.twin import TwinConfig, textured_mesh
from tasks.texturing.unwrapping import SmartUvUnwrapper, XatlasUnwrapper, unwrapped
from tests.samples import lasting
from tests.tasks.candidates.photos import Photos, around, photographed
from tests.tasks.candidates.test_candidates import elsewhere
from tests.tasks.texturing.painting import paint
from tests.tasks.texturing.tools import program

SMALL = FramePainting(twin=TwinConfig(bake=BakeConfig(texel_m=0.01, max_px=256)))
SLOTS = (
    SlotConfig(Textured(of=2, painter=SMALL)),
    SlotConfig(ScanCrop("closed")),
    SlotConfig(Procedural(1)),
    SlotConfig(Textured(of=3, painter=SMALL), fallback=Procedural(5)),
)
"""A twin before its sibling, and one behind it that has a fallback."""


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Photos:
    return photographed(tmp_path_factory.mktemp("photos") / "room")


@pytest.fixture(scope="module")
def outcome(photos: Photos) -> Outcome:
    return photos.offered(*SLOTS, scan=photos.scan)


def by_slot(outcome: Outcome, instance: str = "0001") -> tuple[dict[int, Candidate], dict[int, Asset]]:
    """Rows of an instance, and the assets of those that are filled."""
    assets = {asset.asset_id: asset for asset in outcome.rows["assets"]}
    rows = {row.slot: row for row in outcome.rows["candidates"] if row.instance_id == instance}
    return rows, {slot: assets[row.asset_id] for slot, row in rows.items() if row.asset_id is not None}


def without_skin(asset: Asset) -> Mapping[str, object]:
    """What a twin and its sibling have in common."""
    return {
        name: getattr(asset, name)
        for name in ("category", "author", "pieces_blob", "volume_m3", "is_watertight", "open_reason", "face_count", "source_url")
    }


def test_a_twin_is_the_same_solid_with_another_skin(outcome: Outcome) -> None:
    rows, assets = by_slot(outcome)
    assert [(row.outcome, row.is_fallback, row.twin_of) for _, row in sorted(rows.items())] == [
        ("filled", False, 2), ("filled", False, None), ("filled", False, None), ("filled", False, 3)
    ]  # fmt: skip
    assert {rows[slot].provider for slot in (1, 4)} == {"textured:xatlas"}
    for twin, plain in ((1, 2), (4, 3)):
        assert without_skin(assets[twin]) == without_skin(assets[plain])
        assert np.allclose(assets[twin].extents, assets[plain].extents, atol=1e-6)
        assert (assets[twin].has_texture, assets[plain].has_texture) == (True, False)
        assert assets[twin].provider == f"{assets[plain].provider} textured"
        assert assets[twin].thumbnail_blob != assets[plain].thumbnail_blob
        skin, bare = (surface_of(load_glb(outcome.blobs[asset.mesh_blob])) for asset in (assets[twin], assets[plain]))
        assert np.abs(skin.vertices[skin.faces] - bare.vertices[bare.faces]).max() < 1e-6, "triangle by triangle"
        assert 0.3 < (rows[twin].seen_share or 0.0) <= 1.0
        assert rows[plain].seen_share is None
    assert (assets[1].license, assets[1].source) == ("LicenseRef-scan", "scan test/room")
    assert (assets[4].license, assets[4].source) == ("CC0-1.0 AND LicenseRef-scan", "scan test/room; furniture generator")


def test_charts_are_those_of_the_file(outcome: Outcome) -> None:
    """What rows say of a layout is found again in the asset, by who has nothing but its file."""
    rows, assets = by_slot(outcome)
    charts = {row.asset_id: row for row in outcome.rows["texture_charts"]}
    assert set(charts) == {assets[1].asset_id, assets[4].asset_id}
    for twin, plain in ((1, 2), (4, 3)):
        row = charts[assets[twin].asset_id]
        (part,) = load_glb(outcome.blobs[assets[twin].mesh_blob])
        figures = chart_figures(part.vertices, part.faces, part.visual.uv)
        assert (row.of_asset_id, row.method, row.charts) == (assets[plain].asset_id, "xatlas", figures.charts)
        assert (row.made_by or "").startswith("xatlas ")
        assert [row.coverage, row.stretch_l2, row.seam_ratio] == pytest.approx(
            [figures.coverage, figures.stretch_l2, figures.seam_ratio], rel=1e-3
        )
        image, _ = material_of(part)
        assert image is not None
        assert row.side_px == max(image.shape)
        assert (row.seconds or 0.0) > 0.0
        assert (rows[twin].seconds or 0.0) > 0.0


def test_a_twin_looks_as_the_object_does(photos: Photos, outcome: Outcome) -> None:
    """From where no frame was taken, the twin of the scan's own solid shows the colors of the place; its sibling, in colors of vertices
    from elsewhere, does not."""
    _, assets = by_slot(outcome)
    instance = photos.instances[0]
    pose = np.array(instance.box_pose).reshape(4, 4)
    base = pose.copy()
    base[2, 3] -= 0.5 * instance.box_size[2]
    off = {}
    for slot in (1, 2):
        parts = load_glb(outcome.blobs[assets[slot].mesh_blob])
        for part in parts:
            part.apply_transform(base)
        scene, far = RayScene(parts), []
        for camera in around([*base[:2, 3], 0.4], 6, 1.4, 0.9, 0.25):
            shown = scene.render(camera, shade=False)
            hit = np.isfinite(shown.depth)
            rays = camera.rays()[hit].astype(np.float64)
            places = rays[:, :3] + shown.depth[hit][:, None] * rays[:, 3:]
            near = closest_points(photos.surface.vertices, photos.surface.faces, places)
            level = np.abs(shown.color[hit] - paint(near.point)).max(axis=1)
            far.append(level[near.distance < 0.02])
        off[slot] = float(np.median(np.concatenate(far)))
    assert off[1] < 8.0
    assert off[1] < 0.3 * off[2]


@pytest.mark.whole
def test_the_same_frames_give_the_same_bytes_in_any_order(tmp_path: Path) -> None:
    two = photographed(tmp_path / "room", (1, 2))
    one, other = two.offered(*SLOTS, scan=two.scan), two.offered(*SLOTS, scan=two.scan, spread=elsewhere)
    for table, rows in one.rows.items():
        assert [lasting(row) for row in rows] == [lasting(row) for row in other.rows[table]], table
    assert list(one.blobs.items()) == list(other.blobs.items())
    assert len(one.rows["texture_charts"]) == 4


def test_without_the_scan_twins_are_empty_and_nothing_else_changes(photos: Photos, outcome: Outcome, tmp_path: Path) -> None:
    known, _ = by_slot(outcome)
    broken = tmp_path / "broken"
    broken.mkdir()
    for scan in (None, Scan("posed_rgbd", broken, "rgbd", "room")):
        bare = photos.offered(*SLOTS, scan=scan)
        rows, _ = by_slot(bare)
        assert (rows[1].outcome, rows[1].twin_of) == ("empty", 2)
        assert str(rows[1].reason).startswith("the scan is not at hand, and with it its frames")
        assert (rows[4].outcome, rows[4].is_fallback, rows[4].provider, rows[4].twin_of) == ("filled", True, "procedural", 3)
        assert [lasting(rows[slot]) for slot in (2, 3)] == [lasting(known[slot]) for slot in (2, 3)]
        assert [text for text in bare.degradations if text.startswith("no textured twins: ")] == list(bare.degradations)
        assert bare.rows["texture_charts"] == []
    with pytest.raises(ConnectionError, match="gone: was there when the run was planned"):  # no machine's lack of a folder is a result
        photos.offered(*SLOTS, scan=Scan("posed_rgbd", tmp_path / "gone", "rgbd", "room"))


def test_why_there_is_no_twin(photos: Photos, tmp_path: Path) -> None:
    def reason(scan: Photos, painter: FramePainting = SMALL) -> str:
        rows, _ = by_slot(scan.offered(SlotConfig(Procedural(1)), SlotConfig(Textured(of=1, painter=painter)), scan=scan.scan))
        assert (rows[2].outcome, rows[2].asset_id) == ("empty", None)
        return str(rows[2].reason)

    other = photographed(tmp_path / "room")
    assert "is no program that can be run" in reason(other, FramePainting(unwrapper=SmartUvUnwrapper(program="none/of/this")))
    assert "more than 10" in reason(other, FramePainting(unwrapper=XatlasUnwrapper(max_faces=10)))
    seen = TwinConfig(bake=BakeConfig(max_px=64), least_seen=1.0)
    assert "of its surface, less than 100.0%" in reason(other, FramePainting(twin=seen))
    for file in (tmp_path / "room" / "color").iterdir():
        file.write_bytes(file.read_bytes()[:2000])
    assert "color/" in reason(other)
    assert reason(dataclasses.replace(photos, frames=())) == "the scan has no frames with a pose"


def test_a_slot_without_an_asset_has_no_twin(photos: Photos) -> None:
    bare = dataclasses.replace(photos, instances=(dataclasses.replace(photos.instances[0], mesh_blob=None),))
    rows, _ = by_slot(bare.offered(*SLOTS[:2], scan=photos.scan))
    assert (rows[1].outcome, rows[1].reason) == ("empty", "slot 2 holds no asset to be painted")


@given(count=st.integers(1, 10), own=st.integers(1, 10), of=st.integers(1, 10), other=st.integers(1, 10))
def test_a_twin_is_of_a_slot_that_is_there_and_no_twin(count: int, own: int, of: int, other: int) -> None:
    slots = [SlotConfig(Procedural(k)) for k in range(1, count + 1)]
    for slot in {own, other} & set(range(1, count + 1)):
        slots[slot - 1] = SlotConfig(Textured(of=of))
    painted = {own, other} & set(range(1, count + 1))
    if painted and (of > count or of in painted):
        with pytest.raises(ValueError, match=f"is the twin of slot {of}, which (is a twin itself|does not exist)"):
            CandidatesConfig(slots=tuple(slots))
    else:
        assert CandidatesConfig(slots=tuple(slots)).slots == tuple(slots)


def test_only_who_paints_with_frames_wants_the_scan() -> None:
    painted = TextureCommand(words=("paint", "{mesh}", "{out}"), license="MIT")
    plain = SlotConfig(Procedural(1))
    assert not STAGE.takes_scan(CandidatesConfig())
    assert not STAGE.takes_scan(CandidatesConfig(slots=(plain, SlotConfig(Textured(of=1, painter=painted)))))
    assert STAGE.takes_scan(CandidatesConfig(slots=(plain, SlotConfig(Textured(of=1)))))


@pytest.mark.slow
def test_both_unwrappers_lay_out_the_same_asset(photos: Photos) -> None:
    """Smart UV where METASCENES_BPY names an interpreter that has bpy, or a blender binary."""
    program = os.environ.get("METASCENES_BPY", "")
    if not program:
        pytest.skip("METASCENES_BPY names no interpreter with bpy, and no blender")
    smart = dataclasses.replace(SMALL, unwrapper=SmartUvUnwrapper(program=program))
    slots = (SlotConfig(Procedural(1)), SlotConfig(Textured(of=1, painter=SMALL)), SlotConfig(Textured(of=1, painter=smart)))
    both = photos.offered(*slots, scan=photos.scan)
    rows, assets = by_slot(both)
    assert [rows[slot].provider for slot in (2, 3)] == ["textured:xatlas", "textured:smart_uv"]
    charts = {row.asset_id: row for row in both.rows["texture_charts"]}
    laid = [charts[assets[slot].asset_id] for slot in (2, 3)]
    assert [row.method for row in laid] == ["xatlas", "smart_uv"]
    assert {row.of_asset_id for row in laid} == {assets[1].asset_id}
    assert {row.faces for row in laid} == {assets[1].face_count}
    assert str(laid[1].made_by).startswith("Blender ")
    assert all(row.overlap_share < 0.01 and row.charts >= 1 for row in laid)
    assert assets[2].asset_id != assets[3].asset_id


def tool(folder: Path, sibling: bytes) -> TextureCommand:
    """A program that leaves its asset, in blue."""
    surface = surface_of(load_glb(sibling))
    layout = unwrapped(XatlasUnwrapper(), surface.vertices, surface.faces)
    left = dump_glb([textured_mesh(surface.vertices, layout, np.tile(np.uint8([9, 90, 200]), (64, 64, 1)), 90)], ["mesh"])
    (folder / "left.glb").write_bytes(left)
    copying = program(folder, f"import shutil\nshutil.copy({str(folder / 'left.glb')!r}, sys.argv[2])")
    return TextureCommand(words=(copying, "{mesh}", "{out}", "{prompt}"), model="painter", model_version="2", license="Apache-2.0", seed=5)


def test_a_program_paints_once_what_it_is_given(photos: Photos, outcome: Outcome, tmp_path: Path) -> None:
    _, plain = by_slot(outcome)
    command = tool(tmp_path, outcome.blobs[plain[3].mesh_blob])
    ledger = Recollection()
    slots = (SlotConfig(Procedural(1)), SlotConfig(Textured(of=1, painter=command)))
    first = photos.offered(*slots, ledger=ledger)
    rows, assets = by_slot(first)
    assert (rows[2].outcome, rows[2].provider, rows[2].seed, rows[2].twin_of) == ("filled", "textured:painter", 5, 1), rows[2].reason
    assert assets[2].license == "CC0-1.0 AND LicenseRef-scan AND Apache-2.0"
    (charts,) = first.rows["texture_charts"]
    assert (charts.method, charts.made_by, charts.of_asset_id, charts.side_px) == ("painter", "painter 2", assets[1].asset_id, 64)
    (call,) = ledger.calls.values()
    assert (call.call_id, call.kind, call.model, call.model_version, call.instance_id) == (
        rows[2].call_id, "texture", "painter", "2", "0001",
    )  # fmt: skip
    shutil.rmtree(tmp_path)
    again = photos.offered(*slots, ledger=ledger)
    assert [lasting(row) for row in again.rows["candidates"]] == [lasting(row) for row in first.rows["candidates"]]
    assert list(again.blobs.items()) == list(first.blobs.items())


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"license": ""}, "license: of what painter paints is not stated"),
        ({"words": ()}, "words: name no program"),
        ({"words": ("none/of/this", "{mesh}", "{out}")}, "none/of/this cannot be run"),
        ({"words": ("false", "{mesh}", "{out}")}, "false ended with code 1"),
        ({"words": ("cp", "{mesh}", "{out}")}, "has no texture of base colors"),
    ],
)
def test_a_program_that_paints_nothing_leaves_its_slot_to_the_fallback(photos: Photos, change: Mapping[str, object], said: str) -> None:
    given = {"words": ("true", "{mesh}", "{out}"), "model": "painter", "license": "MIT"} | dict(change)
    twin = Textured(of=1, painter=TextureCommand(**given))  # type: ignore[arg-type]
    rows, _ = by_slot(photos.offered(SlotConfig(Procedural(1)), SlotConfig(twin), SlotConfig(twin, fallback=Procedural(2))))
    assert (rows[2].outcome, rows[2].twin_of) == ("failed", 1)
    assert said in str(rows[2].reason)
    assert (rows[3].outcome, rows[3].is_fallback, rows[3].provider) == ("filled", True, "procedural")
    assert said in str(rows[3].reason)
