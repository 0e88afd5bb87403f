"""Wild rooms: bodies are closed, nothing is in anything, plans are valid, and furniture is of the withheld half alone."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh

from schemas.errors import InputError
from tasks.furniture import CATEGORIES, generate
from tasks.furniture.drafting import Extents, FurnitureModel
from tasks.furniture.dwellings import OVERLAP_M, Dwelling, depths
from tasks.furniture.halves import Half, TemplateWithheld, variants_in
from tasks.furniture.palette import Color
from tasks.furniture.solids import box
from tasks.furniture.wild import WildFurnisher, wild_room
from tasks.furniture.wild.bodies import (
    dish_rack,
    draped_sofa,
    glass_shelf,
    guitar,
    leaning,
    loose_cushion,
    piano,
    screen,
    wall_shelf,
)
from tasks.furniture.wild.foreign import foreign_files, foreign_model
from tasks.furniture.wild.plans import WAY_M, wild_plan
from tasks.furniture.wild.sheets import SizedModel, curtain, heap
from tasks.geometry.mass import mass_properties
from tasks.geometry.meshes import dump_glb, sample_surface, surface_of
from tasks.geometry.pieces import Hull
from tasks.geometry.transforms import yaw_pose
from tasks.optimization.certificates import CertificateConfig, certify
from tasks.optimization.solids import ConvexParts, RigidBody
from tests.tasks.test_furniture import check, depth_outside

SEEDS = (0, 3, 8)


@cache
def made(seed: int) -> Dwelling:
    return wild_room((11, seed))


def sofa(rng: np.random.Generator) -> SizedModel:
    shape = draped_sofa(rng, 2.8, 2.4)
    return SizedModel(shape.model, shape.extents)


BODIES: dict[str, Callable[[np.random.Generator], SizedModel]] = {
    "sofa": sofa,
    "shelf": lambda rng: wall_shelf(rng, 3.8, 2.4).sized,
    "heap": lambda rng: heap(rng, 1.3, 1.5, 0.35),
    "curtain": lambda rng: curtain(rng, 0.6, 2.2),
    "guitar": lambda rng: guitar(rng, 0.2),
    "leaning": lambda rng: leaning(rng, 0.2)[1],
    "piano": piano,
    "rack": dish_rack,
    "screen": lambda rng: screen(rng, 1.2),
    "glass": lambda rng: glass_shelf(rng, 1.0),
    "cushion": loose_cushion,
}


@pytest.mark.parametrize("name", BODIES)
def test_bodies_are_closed_and_covered_by_their_convex_pieces(name: str) -> None:
    rng = np.random.default_rng(1)
    sized = BODIES[name](rng)
    check(sized.model, sized.extents)
    points, _, _ = sample_surface(surface_of(sized.model.parts), 60, rng)
    outside = np.min([depth_outside(piece, points) for piece in sized.model.pieces], axis=0)
    assert outside.max() < 1e-6


@pytest.mark.parametrize("name", BODIES)
def test_the_same_generator_gives_the_same_body(name: str) -> None:
    first, second = (dump_glb(BODIES[name](np.random.default_rng(5)).model.parts) for _ in range(2))
    assert first == second


def test_a_heap_is_as_wide_as_asked_and_bumpy() -> None:
    sized = heap(np.random.default_rng(0), 1.3, 1.5, 0.35)
    assert sized.extents == pytest.approx((1.3, 1.5, 0.35))
    top = np.asarray(sized.model.parts[0].vertices)[: 45 * 39, 2].reshape(45, 39)
    crests = (top[1:-1, 1:-1] > top[:-2, 1:-1]) & (top[1:-1, 1:-1] > top[2:, 1:-1])
    assert crests.sum() > 20


def test_a_wall_of_shelves_has_empty_compartments_and_one_for_a_screen() -> None:
    shelf = wall_shelf(np.random.default_rng(1), 3.8, 2.4)
    wide, tall = shelf.sized.extents[1:]
    assert 8.0 < wide * tall < 10.0
    y0, y1 = shelf.screen[0]
    assert y1 - y0 > 1.0
    pieces = np.array([piece.bounds for piece in shelf.sized.model.pieces])
    for (a, b), (low, high) in (*shelf.openings, shelf.screen):
        middle = np.array([0.0, 0.5 * (a + b), 0.5 * (low + high)])
        assert not ((pieces[:, 0] < middle) & (middle < pieces[:, 1])).all(axis=1).any()


@pytest.mark.parametrize("seed", range(20))
def test_plans_are_valid_and_have_cut_corners_and_openings_without_doors(seed: int) -> None:
    plan = wild_plan(np.random.default_rng((0, seed)))
    polygon = plan.rooms[0].polygon
    outline = shapely.Polygon(polygon)
    assert outline.is_valid
    assert outline.exterior.is_ccw
    ahead = np.roll(polygon, -1, axis=0) - polygon
    assert (np.abs(ahead).min(axis=1) > 0.3).any(), "no corner is cut"
    ways = [opening for opening in plan.openings if opening.kind == "passage"]
    assert ways
    for opening in ways:
        assert WAY_M[0][0] <= opening.width <= WAY_M[0][1]
        assert WAY_M[1][0] <= opening.high <= WAY_M[1][1]
    for opening in plan.openings:
        assert 0.2 < opening.span[0] < opening.span[1] < plan.rooms[0].walls[opening.wall].length - 0.2


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_is_in_anything_and_all_is_inside(seed: int) -> None:
    home = made(seed)
    assert not [pair for pair in depths(home.objects) if pair[2] > OVERLAP_M and not {pair[0], pair[1]} <= home.fitted]
    floor = shapely.Polygon(home.plan.rooms[0].polygon).buffer(1e-3, join_style="mitre")
    for obj in home.objects:
        points = np.concatenate([part.vertices for part in obj.world_parts()])
        assert obj.category in ("door", "window") or shapely.contains_xy(floor, points[:, 0], points[:, 1]).all(), obj.name
        assert -1e-6 < points[:, 2].min() < points[:, 2].max() < home.plan.height + 1e-6


@pytest.mark.parametrize("seed", SEEDS)
def test_a_room_has_what_fails_in_real_scans(seed: int) -> None:
    home = made(seed)
    categories = [obj.category for obj in home.objects]
    for category in ("sofa", "coffee table", "bookshelf", "tv", "clothes", "piano", "guitar", "table", "window"):
        assert category in categories, category
    assert categories.count("chair") >= 2
    assert any(opening.opening.kind == "passage" and opening.instance is None for opening in home.openings)
    by_category = {obj.category: obj for obj in home.objects}
    assert {"sofa", "clothes", "guitar", "tv"} <= {c for c, obj in by_category.items() if obj.name not in home.fitted}
    assert {by_category[c].name for c in ("bookshelf", "window")} <= home.fitted


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_hangs_before_a_window(seed: int) -> None:
    home = made(seed)
    for opening in (row for row in home.openings if row.opening.kind == "window"):
        pane = shapely.LineString(opening.corners[:2, :2]).buffer(0.1)
        low, high = opening.corners[:, 2].min(), opening.corners[:, 2].max()
        for obj in (obj for obj in home.objects if obj.category in ("picture", "mirror")):
            box_center = obj.box_pose[:3, 3]
            assert not (low < box_center[2] < high and pane.contains(shapely.Point(*box_center[:2]))), obj.name


@pytest.mark.whole
def test_what_is_free_holds_still_as_it_was_placed() -> None:
    free, moved = 0, []
    for seed in SEEDS[:2]:
        home = made(seed)
        bodies, poses = [], []
        for obj in home.objects:
            # Curtains are hundreds of pieces that nothing touches.
            if obj.category not in ("curtain", "door", "window"):
                bodies.append(body(obj.name, obj.pieces, obj.name in home.fitted))
                poses.append(obj.pose)
        for number, wall in enumerate(home.plan.rooms[0].walls):
            slab = box((-0.2, 0.0), (-wall.length, 0.0), (0.0, 2.6))
            bodies.append(RigidBody(ConvexParts(f"wall {number}", slab.pieces), 10.0, 0.6, (), True))
            poses.append(yaw_pose(wall.yaw, [*wall.start, 0.0]))
        certified = certify(bodies, np.array(poses), [], CertificateConfig())
        names = {obj.name for obj in home.objects} - home.fitted
        own = [row for row in certified if row.engine == "mujoco" and row.name in names]
        free += len(own)
        moved += [row.name for row in own if not row.is_stable_5cm]
    assert free > 70
    assert len(moved) <= 0.03 * free, moved


def body(name: str, pieces: list[trimesh.Trimesh], is_fixed: bool) -> RigidBody:
    """An object of 300 kg/m3 as engines see it."""
    hulls = tuple(Hull(np.asarray(p.vertices, dtype=np.float64), np.asarray(p.faces, dtype=np.int64)) for p in pieces)
    return RigidBody(ConvexParts(name, hulls), max(300 * mass_properties(hulls).volume, 0.01), 0.6, (), is_fixed)


def test_the_same_seed_gives_the_same_room() -> None:
    first, second = made(3), wild_room((11, 3))
    assert [obj.name for obj in first.objects] == [obj.name for obj in second.objects]
    for one, other in zip(first.furnished.named_parts(), second.furnished.named_parts(), strict=True):
        assert one[0] == other[0]
        assert one[1].vertices.tobytes() == other[1].vertices.tobytes()


# --- halves of the templates -----------------------------------------------------------------------------------------------


def half_of(category: str, half: str, seed: int) -> str | None:
    try:
        return generate(category, None, np.random.default_rng(seed), half=half).name  # type: ignore[arg-type]
    except TemplateWithheld:
        return None


@pytest.mark.parametrize("category", CATEGORIES[::4])
def test_no_template_is_in_both_halves(category: str) -> None:
    names = {half: {half_of(category, half, seed) for seed in range(6)} - {None} for half in ("offered", "withheld")}
    assert not names["offered"] & names["withheld"]
    assert names["offered"] | names["withheld"]


def test_halves_share_the_variants() -> None:
    variants = ("a", "b", "c")
    assert set(variants_in("offered", variants)) | set(variants_in("withheld", variants)) == set(variants)
    assert not set(variants_in("offered", variants)) & set(variants_in("withheld", variants))
    assert variants_in("offered", ("a",)) == variants_in("withheld", ("a",)) == ("a",)


def test_a_wild_room_draws_from_the_withheld_half_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    halves: list[str] = []

    def recorded(
        category: str, extents: Extents | None, rng: np.random.Generator, color: Color | None = None, half: Half = "all"
    ) -> FurnitureModel:
        halves.append(half)
        return generate(category, extents, rng, color, half)

    for module in ("tasks.furniture.furnishing", "tasks.furniture.dwellings", "tasks.furniture.wild"):
        monkeypatch.setattr(f"{module}.generate", recorded)
    wild_room((11, 0))
    assert set(halves) == {"withheld"}
    assert WildFurnisher.half == "withheld"


# --- models by others ------------------------------------------------------------------------------------------------------


def test_models_by_others_furnish_a_room(tmp_path: Path) -> None:
    mesh = BODIES["rack"](np.random.default_rng(0)).model.parts
    (tmp_path / "can.glb").write_bytes(dump_glb(mesh))
    (tmp_path / "index.json").write_text('[{"file": "can.glb", "category": "trash can"}, {"file": "door.glb", "category": "door"}]')
    (file,) = foreign_files(tmp_path)
    body = foreign_model(file)
    assert body.extents[1] >= body.extents[0]
    home = wild_room((11, 0), [file])
    (placed,) = [obj for obj in home.objects if obj.name.endswith("_foreign")]
    assert placed.category == "trash can"


@pytest.mark.parametrize(
    ("content", "problem"), [(None, "name a folder of models"), ('{"a": 1}', "must be a list"), ("[", "write the index again")]
)
def test_a_folder_without_an_index_is_refused(tmp_path: Path, content: str | None, problem: str) -> None:
    if content is not None:
        (tmp_path / "index.json").write_text(content)
    with pytest.raises(InputError, match=problem):
        foreign_files(tmp_path)
