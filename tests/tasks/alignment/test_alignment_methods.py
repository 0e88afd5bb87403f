"""Alignment methods: what each recovers of a pose, the defects that the released ones have, and the snapshots that one goes by."""

from __future__ import annotations

import dataclasses
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from shapely import MultiPoint

from schemas.errors import InputError
from tasks.alignment import AlignmentConfig, Fit, ScannedInstance, Viewpoint, align, lacking, make_target, sample_of, sight_of
from tasks.alignment.acdc import Acdc
from tasks.alignment.fixed_pose import FixedPose
from tasks.alignment.free_pose import FreePose
from tasks.alignment.heuristic import Heuristic
from tasks.alignment.method import AlignmentMethodConfig
from tasks.alignment.methods import METHODS
from tasks.alignment.refined import Refined
from tasks.alignment.snapshots import points_snapshot, surface_snapshot, view_axes
from tasks.geometry.meshes import Surface, canonical, sample_surface, surface_of
from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import look_at, yaw_pose
from tasks.selection.methods import encoders
from tests.tasks.selection.rooms import chair, part

WIDE = [part((0.4, 1.2, 0.5), (0, 0, 0.25)), part((0.06, 1.2, 0.4), (-0.17, 0, 0.7)), part((0.3, 0.1, 0.1), (0, 0.55, 0.55))]
"""Wider than deep, with a back and one arm: it is the same after no turn."""


def seen(surface: Surface, yaw: float, scale: tuple[float, float, float], seed: int = 0) -> ScannedInstance:
    """A surface in a pose, scanned whole and without noise."""
    rng = np.random.default_rng(seed)
    points, colors, _ = sample_surface(surface.transformed(yaw_pose(yaw), scale), 12_000, rng)
    low, high = points.min(axis=0), points.max(axis=0)
    points = points - [*(0.5 * (low + high)[:2]), low[2]]
    return make_target(points, colors, high - low, AlignmentConfig(points=4096), rng)


def found(target: ScannedInstance, surface: Surface, method: AlignmentMethodConfig) -> Fit:
    config = AlignmentConfig(method=method)
    return align(target, sample_of(surface, config, np.random.default_rng(1)), 0.03, config)[0]


def apart(a: float, b: float) -> float:
    """Between two yaws [degrees]."""
    return abs(math.degrees(math.remainder(a - b, 2 * math.pi)))


WHOLE = (Refined(), Heuristic(), FixedPose(), Acdc())


def test_the_default_is_the_first_of_the_family() -> None:
    assert AlignmentConfig().method == METHODS[0].config() == Refined()


@pytest.mark.parametrize("quarter", range(4))
@pytest.mark.parametrize("method", WHOLE, ids=lambda m: m.kind)
def test_every_method_recovers_a_turn_of_quarters(method: AlignmentMethodConfig, quarter: int) -> None:
    surface = surface_of(canonical(WIDE))
    fit = found(seen(surface, 0.5 * math.pi * quarter, (1, 1, 1)), surface, method)
    assert apart(fit.yaw, 0.5 * math.pi * quarter) < 4.0
    assert np.allclose(fit.scale, 1.0, atol=0.03)
    assert np.abs(fit.offset).max() < 0.03


@pytest.mark.parametrize("method", WHOLE, ids=lambda m: m.kind)
def test_a_frame_turned_by_a_quarter_turns_the_pose_and_nothing_else(method: AlignmentMethodConfig) -> None:
    surface = surface_of(canonical(WIDE))
    target = seen(surface, 0.3, (1.0, 1.0, 1.0))
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = dataclasses.replace(target, points=target.points @ turn.T, size=target.size[[1, 0, 2]])
    fit, other = found(target, surface, method), found(turned, surface, method)
    assert apart(other.yaw, fit.yaw + 0.5 * math.pi) < 0.1
    assert np.allclose(other.scale, fit.scale, atol=1e-3)
    assert np.allclose(other.offset, turn @ fit.offset, atol=2e-3)


def test_the_released_fixed_pose_takes_back_for_front_and_the_mended_one_does_not() -> None:
    surface = surface_of(canonical(WIDE))
    target = seen(surface, math.pi, (1, 1, 1))
    assert apart(found(target, surface, FixedPose("as_released")).yaw, 0.0) < 1e-6
    assert apart(found(target, surface, FixedPose()).yaw, math.pi) < 1e-6


def test_the_released_fixed_pose_has_one_scale_for_length_and_width_and_the_mended_one_has_two() -> None:
    surface = surface_of(canonical([part((0.4, 1.2, 0.5), (0, 0, 0.25))]))
    target = seen(surface, 0.0, (1.5, 1.0, 1.2))
    assert np.allclose(found(target, surface, FixedPose("as_released")).scale, (1.0, 1.0, 1.2), atol=0.02)
    assert np.allclose(found(target, surface, FixedPose()).scale, (1.5, 1.0, 1.2), atol=0.02)


def test_the_released_fixed_pose_moves_an_asset_to_what_was_seen_and_the_mended_one_leaves_it_in_its_box() -> None:
    surface = surface_of(canonical([part((0.4, 1.2, 0.5), (0, 0, 0.25))]))
    target = seen(surface, 0.0, (1, 1, 1))
    half = dataclasses.replace(target, points=target.points[target.points[:, 2] > 0.25])
    released = found(half, surface, FixedPose("as_released"))
    assert released.offset[2] > 0.1
    assert np.allclose(found(half, surface, FixedPose()).offset, 0.0)


@pytest.mark.parametrize("azimuth", [-2.0, 0.4, 3.0])
def test_free_pose_looks_into_the_camera_and_the_released_one_gets_narrower_by_its_pitch(azimuth: float) -> None:
    surface = surface_of(canonical(WIDE))
    target = dataclasses.replace(seen(surface, azimuth, (0.8, 0.8, 0.8)), sight=Viewpoint(azimuth, 0.6))
    fit, released = found(target, surface, FreePose()), found(target, surface, FreePose("as_released"))
    assert apart(fit.yaw, azimuth) < 1e-6
    assert np.allclose(fit.scale, 0.8, atol=0.02)
    assert released.scale[1] / released.scale[0] == pytest.approx(math.cos(0.6))
    assert released.scale[2] == pytest.approx(released.scale[0])


def test_what_looks_away_from_the_camera_is_not_missed() -> None:
    """A slab with a thick front that the scan saw from behind: what it has more of in front is no sign of being wrong."""
    surface = surface_of(
        canonical([part((0.05, 0.8, 0.8), (0, 0, 0.4)), *[part((0.02, 0.7, 0.06), (0.2, 0, z)) for z in (0.1, 0.3, 0.5, 0.7)]])
    )
    target = seen(surface, 0.0, (1, 1, 1))
    back = dataclasses.replace(target, points=target.points[target.points[:, 0] < -0.05], sight=Viewpoint(math.pi, 0.0))
    assert apart(found(back, surface, Refined(camera=True)).yaw, 0.0) < 5.0
    blind = dataclasses.replace(back, sight=None)
    assert found(blind, surface, Refined(camera=True)).yaw == found(blind, surface, Refined()).yaw
    assert "nobody knows its camera" in str(lacking(blind, AlignmentConfig(method=Refined(camera=True))))


def test_without_its_camera_free_pose_is_ours_and_says_so() -> None:
    surface = surface_of(canonical(WIDE))
    target = seen(surface, 0.7, (1, 1, 1))
    fit, ours = found(target, surface, FreePose()), found(target, surface, Refined())
    assert (fit.yaw, fit.offset.tolist(), fit.scale.tolist()) == (ours.yaw, ours.offset.tolist(), ours.scale.tolist())
    assert lacking(target, AlignmentConfig(method=FreePose())) == "free_pose: nobody knows its camera; aligned by nearest points"
    assert lacking(target, AlignmentConfig()) is None


@pytest.mark.parametrize("seed", range(6))
def test_snapshots_recover_yaw_and_scale_of_a_whole_object(seed: int) -> None:
    """C.7 of the specification: the yaw within 5 degrees, the scale within a step of the grid, or two where the yaw is a degree off."""
    rng = np.random.default_rng(seed)
    surface, yaw, scale = surface_of(canonical(chair())), float(rng.uniform(-np.pi, np.pi)), float(rng.uniform(0.5, 1.5))
    fit = found(seen(surface, yaw, (scale,) * 3, seed), surface, Acdc())
    assert apart(fit.yaw, yaw) < 5.0
    assert np.abs(fit.scale - scale).max() <= (0.02 if apart(fit.yaw, yaw) < 1.0 else 0.04) + 1e-9


def test_a_sight_says_from_where_the_camera_looks() -> None:
    frame = yaw_pose(0.5, [3.0, -2.0, 0.1])
    middle = frame @ [0.0, 0.0, 0.4, 1.0]
    way = np.array([math.cos(0.5) * math.cos(1.2), math.cos(0.5) * math.sin(1.2), math.sin(0.5)])
    sight = sight_of(look_at(middle[:3] + 2.0 * frame[:3, :3] @ way, middle[:3]), frame, 0.8)
    assert (sight.azimuth, sight.elevation) == pytest.approx((1.2, 0.5))


@pytest.mark.parametrize("azimuth", [0.0, 0.9, 4.0])
def test_a_snapshot_is_what_rays_meet(azimuth: float) -> None:
    """Embree, with parallel rays through the middles of the pixels, had no part in drawing it."""
    surface, side, elevation = surface_of(canonical(chair())), 96, 0.45
    shot = surface_snapshot(surface, azimuth, elevation, side)
    right, up, toward = view_axes(azimuth, elevation)
    size = shot.size.max() / (side - 2)
    column, row = np.meshgrid(np.arange(side) + 0.5, np.arange(side) + 0.5)
    across, along = (column - 0.5 * side) * size + shot.middle[0], (0.5 * side - row) * size + shot.middle[1]
    origins = across[..., None] * right + along[..., None] * up + 10.0 * toward
    hit = RayScene([surface.to_trimesh()]).cast(
        np.concatenate([origins, np.broadcast_to(-toward, origins.shape)], axis=2).astype(np.float32)
    )
    depth = (hit["t_hit"] - 10.0) / (size * side)
    differ = shot.silhouette != np.isfinite(depth)
    assert differ.mean() < 2e-3, "but for rays along an edge"
    both = shot.silhouette & np.isfinite(depth)
    assert np.quantile(np.abs(shot.depth[both] - depth[both]), 0.99) < 1e-4


def test_snapshots_of_points_close_their_holes_and_grow_by_nothing() -> None:
    box = surface_of([trimesh.creation.box((0.5, 0.8, 0.6))])
    points, _, _ = sample_surface(box, 1500, np.random.default_rng(0))
    shot, whole = points_snapshot(points, 0.04, 0.5, 0.4, 64), surface_snapshot(box, 0.5, 0.4, 64)
    exact = MultiPoint(box.vertices @ view_axes(0.5, 0.4)[:2].T).convex_hull.area * (62 / whole.size.max()) ** 2
    assert whole.silhouette.sum() == pytest.approx(exact, rel=0.01)
    assert shot.silhouette.sum() == pytest.approx(exact, rel=0.06)
    assert (shot.silhouette & whole.silhouette).sum() > 0.93 * (shot.silhouette | whole.silhouette).sum()


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny DINOv2 that has learned nothing: even so the same picture has the same patches."""
    torch = pytest.importorskip("torch")
    transformers = pytest.importorskip("transformers")
    torch.manual_seed(0)
    config = transformers.Dinov2Config(
        hidden_size=32, num_hidden_layers=2, num_attention_heads=2, image_size=56, patch_size=14, mlp_ratio=2
    )
    folder = tmp_path_factory.mktemp("dinov2")
    transformers.Dinov2Model(config).save_pretrained(folder, safe_serialization=True)
    return folder


@pytest.mark.parametrize("step", [3, 11])
def test_the_patches_of_a_photo_find_the_snapshot_that_it_is(weights: Path, step: int) -> None:
    parts = [part((0.5, 0.8, 0.4), (0, 0, 0.2), (200, 40, 40)), part((0.1, 0.8, 0.5), (-0.2, 0, 0.65), (40, 60, 200))]
    surface, azimuth, elevation = surface_of(canonical(parts)), 0.3, 0.5
    method = Acdc(snapshots=20, between=1, picture_pixels=56, dinov2=str(weights))
    yaw = azimuth - 2 * np.pi * step / 20
    photo = surface_snapshot(surface, 2 * np.pi * step / 20, elevation, 112).color
    target = dataclasses.replace(seen(surface, yaw, (1, 1, 1)), sight=Viewpoint(azimuth, elevation, photo))
    assert apart(found(target, surface, method).yaw, yaw) < 1e-6
    assert lacking(target, AlignmentConfig(method=method)) is None
    assert "no photo" in str(lacking(seen(surface, yaw, (1, 1, 1)), AlignmentConfig(method=method)))


def photographed() -> tuple[ScannedInstance, Surface]:
    surface = surface_of(canonical(chair()))
    return dataclasses.replace(seen(surface, 0.0, (1, 1, 1)), sight=Viewpoint(0.0, 0.4, np.zeros((8, 8, 3), np.uint8))), surface


def test_a_folder_without_weights_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no \*\.safetensors"):
        found(*photographed(), Acdc(dinov2=str(tmp_path)))


def test_weights_that_lack_a_part_are_refused(tmp_path: Path, weights: Path) -> None:
    """They would be drawn at random, each time others."""
    from safetensors.torch import load_file, save_file

    for file in weights.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    whole = load_file(tmp_path / "model.safetensors")
    left = {name: values for name, values in whole.items() if "layer.1" not in name}
    save_file(left, tmp_path / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(InputError, match=f"lacks {len(whole) - len(left)} of its weights"):
        found(*photographed(), Acdc(dinov2=str(tmp_path), snapshots=4, picture_pixels=56))


def test_without_the_packages_a_line_says_how_they_get_there(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    encoders._dino.cache_clear()
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(InputError, match=r"selection: transformers: is not installed; pip install 'metascenes\[encoders\]'"):
        found(*photographed(), Acdc(dinov2=str(weights), snapshots=4, picture_pixels=56))
