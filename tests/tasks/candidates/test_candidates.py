"""The stage: ten slots of each instance, filled or empty with a reason."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import pickle
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

from schemas.capture import Instance
from tasks.candidates import STAGE, CandidatesConfig, SlotConfig
from tasks.candidates.library import LibraryRetrieval
from tasks.candidates.procedural import Procedural, fronted_extents
from tasks.candidates.scan_crop import ScanCrop
from tasks.geometry.meshes import load_glb, surface_of
from tasks.stage import Outcome
from tasks.views.pictures import THUMBNAIL_PX
from tests.samples import lasting
from tests.tasks.candidates.crops import (
    candidates_of,
    furniture,
)
from tests.tasks.candidates.libraries import write_library


def a_room() -> list[tuple[Instance, dict[str, bytes]]]:
    return [
        furniture(2, "chair", (0.5, 0.48, 0.95), 0.4),
        furniture(1, "nightstand", (0.4, 0.55, 0.5), 1.9),
        furniture(4, "gizmo", (0.3, 0.2, 0.25), 0.0),
        furniture(3, "box", (0.3, 0.3, 0.3), 0.0, is_structure=True),
    ]


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    return candidates_of(*a_room())


def test_ten_slots_are_filled_and_every_asset_is_canonical(outcome: Outcome) -> None:
    rows, assets = outcome.rows["candidates"], {asset.asset_id: asset for asset in outcome.rows["assets"]}
    assert [(row.instance_id, row.slot) for row in rows] == [(f"000{i}", s) for i in (1, 2, 4) for s in range(1, 11)]
    assert {row.outcome for row in rows} == {"filled"}
    assert {row.asset_id for row in rows} == set(assets)
    named = {blob for asset in assets.values() for blob in (asset.mesh_blob, asset.pieces_blob, asset.thumbnail_blob) if blob}
    assert named == set(outcome.blobs)
    for name, data in outcome.blobs.items():
        assert name.split(".")[0] == hashlib.sha256(data).hexdigest()
    for asset in assets.values():
        assert asset.mesh_blob == f"{asset.asset_id}.glb"
        surface = surface_of(load_glb(outcome.blobs[asset.mesh_blob]))
        low, high = surface.bounds
        with PIL.Image.open(io.BytesIO(outcome.blobs[asset.thumbnail_blob or ""])) as picture:
            assert (picture.format, picture.size) == ("PNG", (THUMBNAIL_PX, THUMBNAIL_PX))
            shown = np.asarray(picture) < 250
        assert shown.any(axis=2).mean() > 0.05
        assert shown.any(axis=(1, 2)).all() or shown.any(axis=(0, 2)).all(), "as large as its square lets it be"
        assert np.allclose([*(low + high)[:2], low[2]], 0, atol=1e-6)
        assert np.allclose(high - low, asset.extents, atol=1e-6)
        assert (len(surface.vertices), len(surface.faces)) == (asset.vertex_count, asset.face_count)
        assert 0 < asset.volume_m3 < np.prod(asset.extents) * 1.2
        if asset.pieces_blob:
            corners = np.concatenate([piece.vertices for piece in load_glb(outcome.blobs[asset.pieces_blob])])
            assert np.allclose([corners.min(axis=0), corners.max(axis=0)], [low, high], atol=0.01 + 0.02 * np.ptp(surface.bounds))
        if asset.provider.startswith("scan_crop"):
            assert asset.is_watertight
            assert asset.source == "scan test/room"


def test_models_have_the_size_of_the_instance(outcome: Outcome) -> None:
    assets = {asset.asset_id: asset for asset in outcome.rows["assets"]}
    for row in outcome.rows["candidates"]:
        asset = assets[row.asset_id or ""]
        if row.provider == "procedural" and row.instance_id == "0002":
            assert np.allclose(sorted(asset.extents), sorted((0.5, 0.48, 0.95)), atol=1e-5)
            assert asset.category == "chair"
        if row.provider == "scan_crop_closed" and row.instance_id == "0001":
            assert np.allclose(asset.extents, (0.4, 0.55, 0.5), atol=0.03)
    styles = {row.asset_id for row in outcome.rows["candidates"] if row.instance_id == "0002" and row.slot <= 4}
    assert len(styles) >= 2


def test_a_missing_library_is_told_in_every_row_and_once_in_all() -> None:
    outcome = candidates_of(furniture(1, "table", (0.8, 1.3, 0.75), 0.2))
    for row in outcome.rows["candidates"]:
        assert row.is_fallback == (row.slot >= 7)
        assert row.provider == ("parametric" if row.slot == 4 else "procedural" if row.slot <= 3 or row.slot >= 7 else row.provider)
        assert (row.reason == "no library given") == (row.slot >= 7)
    assert sum("no library given" in text for text in outcome.degradations) == 1


@pytest.mark.whole
def test_a_library_fills_its_slots_and_the_same_asset_is_the_same_row(tmp_path: Path) -> None:
    folder = write_library(
        tmp_path / "lib", chair_a=("chair", (0.5, 0.5, 0.9)), chair_b=("chair", (0.45, 0.45, 0.8)), bed_c=("bed", (2.0, 1.6, 0.9))
    )
    pairs = [furniture(1, "chair", (0.5, 0.5, 0.9), 0.3), furniture(2, "chair", (0.48, 0.5, 0.92), 1.2)]
    both = candidates_of(*pairs, library=folder)
    alone = candidates_of(pairs[1], library=folder)
    for outcome in (both, alone):
        rows = [row for row in outcome.rows["candidates"] if row.instance_id == "0002" and row.slot >= 7]
        assert [(row.provider, row.is_fallback) for row in rows[:2]] == [("library", False)] * 2
        assert all(row.provider == "procedural" and row.is_fallback and "come near enough" in (row.reason or "") for row in rows[2:])
    found = [{a.asset_id: a for a in o.rows["assets"] if a.provider == "library"} for o in (both, alone)]
    assert found[0] == found[1]
    assert {asset.name for asset in found[0].values()} == {"chair_a", "chair_b"}


def test_one_bad_instance_costs_only_its_own_slots() -> None:
    good = furniture(1, "stool", (0.4, 0.4, 0.5), 0.2)
    instance, files = furniture(2, "box", (0.4, 0.4, 0.4), 0.2)
    broken = (instance, {name: (b"no glb" if name == instance.mesh_blob else data) for name, data in files.items()})
    bare = furniture(3, "box", (0.3, 0.4, 0.2), 0.2, mesh_blob=None)
    outcome = candidates_of(good, broken, bare)
    results = {(row.instance_id, row.slot): row for row in outcome.rows["candidates"]}
    assert {results["0001", slot].outcome for slot in range(1, 11)} == {"filled"}
    assert [results["0002", slot].outcome for slot in (4, 5, 6, 7)] == ["filled", "failed", "failed", "filled"]
    assert "is not a readable GLB" in (results["0002", 5].reason or "")
    assert [results["0003", slot].outcome for slot in (4, 5, 6)] == ["filled", "empty", "empty"]
    assert results["0003", 5].reason == "the scan has no faces of the instance"
    assert sum("0002 box: slot" in text for text in outcome.degradations) == 2


def elsewhere(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """As other processes do it: with copies, and done in another order."""
    assert len(items) > 1
    done = [pickle.loads(pickle.dumps(function(pickle.loads(pickle.dumps(item))))) for item in items[::-1]]
    return done[::-1]


@pytest.mark.whole
def test_the_same_input_gives_the_same_bytes_in_any_order(outcome: Outcome) -> None:
    other = candidates_of(*a_room()[::-1], spread=elsewhere)
    for table, rows in outcome.rows.items():
        assert [lasting(row) for row in rows] == [lasting(row) for row in other.rows[table]]
    assert outcome.degradations == other.degradations
    assert list(outcome.blobs.items()) == list(other.blobs.items())


def test_another_seed_draws_other_models() -> None:
    config = CandidatesConfig(slots=(SlotConfig(Procedural(1)),))
    one, other = (candidates_of(furniture(1, "chair", (0.5, 0.5, 0.9), 0.2), config=config, seed=seed) for seed in (1, 2))
    assert one.rows["assets"] != other.rows["assets"]


def test_slots_are_config() -> None:
    config = CandidatesConfig(slots=(SlotConfig(ScanCrop("closed")), SlotConfig(LibraryRetrieval(1)), SlotConfig(Procedural(1))))
    rows = candidates_of(furniture(1, "stool", (0.4, 0.4, 0.5), 0.2), config=config).rows["candidates"]
    assert [(row.provider, row.outcome) for row in rows] == [("scan_crop_closed", "filled"), ("library", "empty"), ("procedural", "filled")]
    assert rows[1].reason == "no library given"
    with pytest.raises(ValueError, match=r"^slots: must be a list of at least 1, is \(\)$"):
        CandidatesConfig(slots=())
    assert dataclasses.is_dataclass(STAGE.config)


def test_the_long_side_is_laid_as_the_category_has_it() -> None:
    assert fronted_extents("sofa", (2.0, 0.9, 0.8)) == (0.9, 2.0, 0.8)
    assert fronted_extents("sofa", (0.9, 2.0, 0.8)) == (0.9, 2.0, 0.8)
    assert fronted_extents("stool", (0.4, 0.35, 0.5)) == (0.4, 0.35, 0.5)
