"""What carries an object, and the forest that all objects and their carriers are; in generated rooms as they were made."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.capture import Shell
from tasks.furniture import generate
from tasks.furniture.rooms import ROOM_TYPES, FurnishedRoom, furnish
from tasks.geometry.meshes import surface_of
from tasks.geometry.transforms import translation, yaw_pose
from tasks.mounting import mounting
from tasks.optimization.support.fastening import is_fixed, is_worktop
from tasks.optimization.support.heights import plan_view
from tasks.optimization.support.supports import (
    PlacedAsset,
    SupportConfig,
    descendants,
    find_carriers,
    is_covering,
    is_floor_covering,
    support_map,
)
from tasks.optimization.support.walls import wall_snap
from tasks.shell import room_shell
from tests.samples import sample
from tests.tasks.optimization.support.furnishings import (
    BELOW,
    BIN,
    CHAIR,
    CLOTH,
    CONFIG,
    FRAME,
    MAT,
    SCENE,
    SEAT,
    SHELF,
    SMALL,
    SOFA,
    STOOL,
    TABLE,
    at,
    block,
    is_boxy,
    placed,
    room,
    small,
    upside_down,
)

# the relation and the parent of single objects

SOFA_AT_WALL = placed("0001", block(0.9, 2, 0.8), translation([-1.5, 0, 0]))

CARRIED: dict[str, tuple[list[PlacedAsset], tuple[str, str | None, float]]] = {
    "on the floor, a little above it": ([small(0, 0, 0.04, TABLE)], ("floor", None, 0.04)),
    "in the floor": ([small(0, 0, -0.06, TABLE)], ("floor", None, -0.06)),
    "deep in the floor": ([small(0, 0, -0.4, TABLE)], ("floor", None, -0.4)),
    "on a table": ([small(0.3, 0, 0.8), BELOW], ("on", "0001", 0.05)),
    "sunk into a table": ([small(0.3, 0, 0.7), BELOW], ("on", "0001", -0.05)),
    "16 cm over a table": ([small(0.3, 0, 0.91), BELOW], ("on", "0001", 0.16)),
    "16 cm deep in a block": ([small(0, 0, 0.64), at(1, block(1, 1, 0.8), 0, 0, 0)], ("on", "0001", -0.16)),
    "on a board of a shelf": ([small(0, 0.2, 1.05), at(1, SHELF, 0, 0, 0)], ("inside", "0001", 0.03)),
    "on the lowest board of a shelf": ([small(0, 0.2, 0.01), at(1, SHELF, 0, 0, 0)], ("inside", "0001", -0.03)),
    "on the lowest board of a raised shelf": ([small(0, 0.2, 0.01), at(1, SHELF, 0, 0, 0.05)], ("inside", "0001", -0.08)),
    "on a shelf's top": ([small(0, 0.2, 1.52), at(1, SHELF, 0, 0, 0)], ("on", "0001", 0.02)),
    "in a bin": ([small(0.05, 0.05, 0.03), at(1, BIN, 0, 0, 0)], ("inside", "0001", 0.02)),
    "on a lid over a bin": ([small(0, 0, 0.42, block(0.3, 0.3, 0.05)), at(1, BIN, 0, 0, 0)], ("on", "0001", 0.02)),
    "on a sofa's seat": ([small(0.1, 0.3, 0.47, block(0.15, 0.4, 0.3), "pillow"), at(1, SOFA, 0, 0, 0, "sofa")], ("on", "0001", 0.02)),
    "over the edge of a table": ([small(0.64, 0, 0.75), BELOW], ("none", None, 0.75)),
    "on a table that is too high": ([small(0, 0, 0.83), placed("0001", TABLE, translation([0, 0, 0.05]))], ("on", "0001", 0.03)),
    "under a table": ([small(0, 0, 0, STOOL), BELOW], ("floor", None, 0.0)),
    "a chair under a table": ([small(0.6, 0, 0, CHAIR, "chair"), BELOW], ("floor", None, 0.0)),
    "a table over a chair": ([small(0, 0, 0, TABLE, "table"), at(1, CHAIR, 0.6, 0, 0, "chair")], ("floor", None, 0.0)),
    "a raised table over a chair": ([small(0, 0, 0.08, TABLE, "table"), at(1, CHAIR, 0.6, 0, 0, "chair")], ("floor", None, 0.08)),
    "a raised chair under a sunk table": ([small(0.5, 0, 0.07, CHAIR, "chair"), at(1, TABLE, 0, 0, -0.07)], ("floor", None, 0.07)),
    "a chair upside down on a table": (
        # the seat lies on the table's edge, the back hangs down before it
        [small(-0.46, 0, 0.3, upside_down(CHAIR, 0.92), "chair"), BELOW],
        ("on", "0001", 0.0),
    ),
    "a table upside down": ([small(0, 0, 0.03, upside_down(TABLE, 0.75), "table")], ("floor", None, 0.03)),
    "on a table that lies upside down": ([small(0, 0, 0.05), at(1, upside_down(TABLE, 0.75), 0, 0, 0, "table")], ("on", "0001", 0.01)),
    "on a rug with all feet": ([small(0, 0, 0, STOOL), placed("0001", MAT, np.eye(4))], ("on", "0001", -0.02)),
    "on a rug with a third": ([small(0.82, 0, 0, STOOL), placed("0001", MAT, np.eye(4))], ("floor", None, 0.0)),
    "a bed on a small rug": ([small(0, 0, 0, block(2, 1.6, 0.5), "bed"), at(1, MAT, 0, 0, 0, "rug")], ("floor", None, 0.0)),
    "a rug under a bed": ([small(0, 0, 0, MAT, "rug"), at(1, block(2, 1.6, 0.5), 0, 0, 0, "bed")], ("floor", None, 0.0)),
    "a rug under a bed that sank in": ([small(0, 0, 0.02, MAT, "rug"), at(1, block(2, 1.6, 0.1), 0, 0, -0.06)], ("floor", None, 0.02)),
    "a cloth over a table": ([small(0, 0, 0.56, CLOTH, "tablecloth"), BELOW], ("on", "0001", 0.01)),
    "the larger of two flat objects carries": (
        [small(0, 0, 0.01, block(0.4, 0.3, 0.03)), placed("0001", block(0.6, 0.5, 0.03), np.eye(4))],
        ("on", "0001", -0.02),
    ),
    "on the one of two tables that has most of it": (
        [small(0.63, 0, 0.75, block(0.4, 0.4, 0.1)), BELOW, at(2, TABLE, 1.21, 0, 0.02, "table")],
        ("on", "0002", -0.02),
    ),
    "deep in a block": ([small(0, 0, 0.9), placed("0001", block(1, 1, 0.6), translation([0, 0, 0.8]))], ("none", None, 0.9)),
    "on legs that were not scanned": ([small(0, 0, 0.3)], ("floor", None, 0.3)),
    "a chair by the wall on legs that were not scanned": ([small(-1.75, 0, 0.25, SEAT, "chair")], ("floor", None, 0.25)),
    "a chair far above the floor": ([small(-1.75, 0, 0.4, SEAT, "chair")], ("none", None, 0.4)),
    "a chair over a rug on legs that were not scanned": (
        [small(0, 0, 0.25, SEAT, "office chair"), at(1, MAT, 0, 0, 0, "rug")],
        ("on", "0001", 0.23),
    ),
    "on the wall": ([small(-1.95, 0, 1.2, FRAME, "picture")], ("wall", None, 0.0)),
    "on the wall above a sofa's back": ([small(-1.95, 0, 0.85, FRAME, "picture"), SOFA_AT_WALL], ("wall", None, 0.0)),
    "a picture that stands": ([small(-1.95, 0, 0.81, FRAME, "picture"), SOFA_AT_WALL], ("on", "0001", 0.01)),
    "a small picture on a table at the wall": (
        [small(-1.9, 0, 0.8, block(0.03, 0.14, 0.18), "picture"), at(1, TABLE, -1.4, 0, 0)],
        ("on", "0001", 0.05),
    ),
    "a curtain down to the floor": ([small(-1.95, 0, 0.0, block(0.08, 1.2, 2.2), "curtain")], ("wall", None, 0.0)),
    "a shower curtain across the room": ([small(0, 0, 0.3, block(0.03, 1.2, 1.8), "shower curtain")], ("ceiling", None, 0.0)),
    "a door": ([small(2.06, 0, 0.0, block(0.12, 0.9, 2.0), "door")], ("wall", None, 0.0)),
    "a television on the wall": ([small(-1.93, 0, 1.2, block(0.06, 1.1, 0.6), "tv")], ("wall", None, 0.0)),
    "a television on a table": ([small(-1.93, 0, 0.77, block(0.06, 1.1, 0.6), "tv"), at(1, TABLE, -1.6, 0, 0)], ("on", "0001", 0.02)),
    "a kitchen cabinet on the wall": ([small(-1.8, 0, 1.4, block(0.35, 0.8, 0.7), "kitchen cabinet")], ("wall", None, 0.0)),
    "a kitchen cabinet that stands": ([small(-1.7, 0, 0.02, block(0.6, 0.8, 0.85), "kitchen cabinet")], ("floor", None, 0.02)),
    "a worktop on the wall above nothing": ([small(-1.69, 0, 0.8, block(0.62, 1.5, 0.04), "kitchen counter")], ("wall", None, 0.0)),
    "a worktop in the middle of the room": ([small(0, 0, 0.25, block(0.62, 1.5, 0.04), "kitchen counter")], ("floor", None, 0.25)),
    "something flat on the wall": ([small(-1.97, 0, 1.2, block(0.06, 0.4, 0.3))], ("wall", None, 0.0)),
    "something deep before the wall": ([small(-1.4, 0, 1.2, block(1.1, 0.4, 0.3))], ("none", None, 1.2)),
    "under the ceiling": ([small(0, 0, 2.15, block(0.4, 0.4, 0.3), "lamp")], ("ceiling", None, 0.0)),
    "a lamp whose cable was not scanned": ([small(0, 0, 1.5, block(0.4, 0.4, 0.3), "ceiling lamp"), BELOW], ("ceiling", None, 0.0)),
    "a chandelier low over nothing": ([small(0, 0, 0.9, block(0.6, 0.6, 0.5), "chandelier")], ("ceiling", None, 0.0)),
    "a ceiling lamp that lies on the floor": ([small(0, 0, 0.01, block(0.4, 0.4, 0.3), "ceiling lamp")], ("floor", None, 0.01)),
    "in the air": ([small(0, 0, 1.0, block(0.4, 0.4, 0.3))], ("none", None, 1.0)),
}  # fmt: skip


@pytest.mark.parametrize("name", CARRIED)
def test_what_carries_an_object(name: str) -> None:
    objects, (relation, parent, gap) = CARRIED[name]
    for order in (objects, objects[::-1]):
        carriers = find_carriers(order, room(), CONFIG)
        found = carriers["0000"]
        assert (found.relation, found.parent_id) == (relation, parent)
        assert found.gap == pytest.approx(gap, abs=1e-6)
    below = carriers.get(parent or "")
    expected = (-gap if relation in ("on", "inside", "floor") else 0.0) + (below.lift if below else 0.0)
    assert carriers["0000"].lift == pytest.approx(expected, abs=1e-6)


def test_a_generated_bowl_and_basket_hold_what_is_in_them() -> None:
    for category, size in (("bowl", (0.3, 0.3, 0.12)), ("basket", (0.4, 0.4, 0.3)), ("trash can", (0.35, 0.35, 0.5))):
        container = generate(category, size, np.random.default_rng(2)).parts
        view = plan_view(surface_of(container), [-0.02, -0.02], [0.02, 0.02], np.inf, 0.01)
        floor = float(view.heights.max())
        objects = [at(0, block(0.05, 0.05, 0.05), 0, 0, floor), at(1, container, 0, 0, 0, category)]
        found = find_carriers(objects, room(), CONFIG)["0000"]
        assert (found.relation, found.parent_id) == ("inside", "0001"), (category, found)


def test_objects_on_a_tablecloth_stand_on_it_and_it_on_the_table() -> None:
    objects = [at(0, SMALL, 0.1, 0, 0.77), at(1, TABLE, 0, 0, 0, "table"), at(2, CLOTH, 0, 0, 0.55, "tablecloth")]
    found = find_carriers(objects, room(), CONFIG)
    assert [found[n].parent_id for n in ("0000", "0001", "0002")] == ["0002", None, "0001"]
    assert is_covering(objects[2], CONFIG)
    assert not is_floor_covering(objects[2], CONFIG)


def test_coverings_are_flat_and_large_or_called_so() -> None:
    assert is_floor_covering(small(0, 0, 0, MAT), CONFIG)
    assert is_floor_covering(small(0, 0, 0.06, block(0.7, 0.5, 0.03), "bath mat"), CONFIG)
    assert not is_floor_covering(small(0, 0, 0.8, MAT, "rug"), CONFIG)
    for parts, category in ((block(0.3, 0.2, 0.03), "book"), (block(0.45, 0.15, 0.03), "keyboard"), (MAT, "bed"), (STOOL, "thing")):
        assert not is_covering(small(0, 0, 0, parts, category), CONFIG)
    assert not is_covering(small(0, 0, 0, block(0.2, 0.2, 1.5), "rug"), CONFIG)  # rolled up in a corner


def test_categories_are_found_by_their_last_words() -> None:
    for name, kind in (("picture", "frame"), ("Pictures", "frame"), ("wooden dining chair", "stands"), ("white_board", "frame"),
                       ("shelves", "any"), ("couch", "stands"), ("window", "let_in"), ("curtains", "wall"), ("ceiling lamp", "ceiling"),
                       ("desk lamp", "stands"), ("lamp", "either"), ("rug", "covering"), ("zebra", "any"),
                       ("tv console", "either"), ("drawer", "any"), ("binder", "any")):  # fmt: skip
        assert mounting(name).kind == kind, name
    assert mounting("toilet").is_built_in
    assert not mounting("toilet paper").is_built_in


# the graph


@given(seed=st.integers(0, 10**6), n=st.integers(1, 8))
@settings(max_examples=40, deadline=None)
def test_nothing_carries_itself_and_what_is_carried_rests(seed: int, n: int) -> None:
    """Piles of flat blocks, thrown together: no circle, and every rested bottom is at its carrier's top or on the floor."""
    rng = np.random.default_rng(seed)
    pile = []
    for i in range(n):
        pose = yaw_pose(rng.uniform(0, 3), [*rng.uniform(-0.3, 0.3, 2), rng.uniform(0, 0.3)])
        pile.append(placed(f"{i:04d}", block(*rng.uniform(0.1, 0.6, 2), rng.uniform(0.02, 0.15)), pose))
    carriers = find_carriers(pile, None, CONFIG)
    by_id = {p.instance_id: p for p in pile}
    for name, carrier in carriers.items():
        rested = by_id[name].low[2] + carrier.lift
        if carrier.relation == "floor":
            assert rested == pytest.approx(0.0, abs=1e-9)
        if carrier.relation == "on":
            assert carrier.parent_id is not None
            assert rested == pytest.approx(by_id[carrier.parent_id].high[2] + carriers[carrier.parent_id].lift, abs=1e-9)


CATEGORIES = ("thing", "table", "chair", "picture", "rug", "tv", "ceiling lamp", "curtain", "tablecloth", "box", "toilet")
boxes = st.tuples(
    st.tuples(*[st.floats(-2.2, 2.2)] * 2, st.floats(-0.2, 2.6)), st.tuples(*[st.floats(0.02, 1.5)] * 3), st.floats(-3, 3),
    st.sampled_from(CATEGORIES),
)  # fmt: skip


@pytest.mark.whole
@given(st.lists(boxes, min_size=1, max_size=14), st.randoms(use_true_random=False))
@settings(max_examples=120, deadline=None)
def test_the_graph_is_a_forest_whatever_is_in_the_room(drawn: Any, shuffle: Any) -> None:
    """No circles; parents reach below their children; gap, lift and what a relation names fit together; order is no matter."""
    objects = [at(i, block(*size), *place, category, yaw) for i, (place, size, yaw, category) in enumerate(drawn)]
    by_id = {obj.instance_id: obj for obj in objects}
    carriers = find_carriers(objects, room(), CONFIG)
    assert list(carriers) == sorted(by_id)
    parts = {name for name, _ in room_shell(room())} | {"ceiling"}
    for name, carrier in carriers.items():
        seen, above = {name}, carrier.parent_id
        while above is not None:
            assert above not in seen
            seen.add(above)
            above = carriers[above].parent_id
        obj = by_id[name]
        assert (carrier.parent_id is not None) == (carrier.relation in ("on", "inside"))
        assert carrier.against is None or carrier.against in parts - {"floor"}
        holds = {below for below, other in carriers.items() if other.parent_id == name and other.is_fixed}
        is_slab = is_worktop(obj, carrier) and carrier.against is not None
        assert carrier.is_fixed == (is_fixed(carrier, obj.category, carrier.against) or is_slab or bool(holds and is_boxy(obj)))
        if carrier.parent_id is not None:
            parent = by_id[carrier.parent_id]
            assert parent.low[2] <= obj.low[2] + CONFIG.reach_m
            assert -CONFIG.sunk_m - 1e-9 <= carrier.gap <= CONFIG.stand_drop_m + 1e-9
            assert carrier.lift == pytest.approx(carriers[carrier.parent_id].lift - carrier.gap, abs=1e-9)
        elif carrier.relation == "floor":
            assert carrier.gap == pytest.approx(obj.low[2], abs=1e-9)
            assert carrier.lift == -carrier.gap
        elif carrier.relation in ("wall", "ceiling"):
            assert carrier.gap == carrier.lift == 0.0
            assert carrier.against is not None
        else:
            assert carrier.lift == 0.0
    below = descendants({name: c.parent_id for name, c in carriers.items()})
    assert all(name not in others for name, others in below.items())
    mixed = list(objects)
    shuffle.shuffle(mixed)
    assert find_carriers(mixed, room(), CONFIG) == carriers


# generated rooms


@cache
def furnished(seed: int, count: int = 40) -> FurnishedRoom:
    return furnish(ROOM_TYPES[seed % len(ROOM_TYPES)], np.random.default_rng(seed), count, clutter=(seed % 3) / 2)


def objects_of(made: FurnishedRoom, offsets: Sequence[float]) -> tuple[list[PlacedAsset], Shell]:
    """A generated room's objects, each raised by its offset [m], as assets and as a room's row."""
    objects = [
        PlacedAsset.of(f"{i:04d}", obj.category, surface_of(obj.parts).transformed(translation([0, 0, offset]) @ obj.pose),
                       all(part.is_watertight for part in obj.parts))
        for i, (obj, offset) in enumerate(zip(made.objects, offsets, strict=True))
    ]  # fmt: skip
    polygon = tuple(tuple(map(float, corner)) for corner in made.polygon)
    return objects, sample(Shell, scene_id=SCENE, floor_polygon=polygon, walls=(), interior_walls=(), height_m=made.height)


def misses(made: FurnishedRoom, offsets: Sequence[float]) -> list[str]:
    """Objects whose relation or parent is not the generator's; what the generator put onto the floor may stand on a rug."""
    objects, place = objects_of(made, offsets)
    found = find_carriers(objects, place, CONFIG)
    wrong = []
    for obj, asset in zip(made.objects, objects, strict=True):
        carrier = found[asset.instance_id]
        parent = made.objects[int(carrier.parent_id)] if carrier.parent_id is not None else None
        got = parent.name if parent is not None else carrier.relation
        if got != obj.parent and not (obj.parent == "floor" and parent is not None and parent.category == "rug"):
            wrong.append(f"{obj.name} on {obj.parent}: found {carrier.relation} {got}, gap {carrier.gap:.3f}")
    return wrong


@pytest.mark.slow
@pytest.mark.whole
def test_generated_rooms_have_the_supports_that_they_were_made_with() -> None:
    count, wrong = 0, []
    for seed in range(20):
        made = furnished(seed)
        count += len(made.objects)
        wrong += misses(made, [0.0] * len(made.objects))
    assert count > 700
    assert len(wrong) <= 0.03 * count, "\n".join(wrong)


@pytest.mark.slow
@pytest.mark.whole
def test_generated_rooms_have_them_with_everything_off_by_up_to_8_cm() -> None:
    count, wrong = 0, []
    for seed in range(20):
        made = furnished(seed)
        rng = np.random.default_rng(1000 + seed)
        offsets = [0.0 if obj.parent in ("wall", "ceiling") else float(rng.uniform(-0.08, 0.08)) for obj in made.objects]
        count += len(made.objects)
        wrong += misses(made, offsets)
    assert len(wrong) <= 0.07 * count, "\n".join(wrong)


@pytest.mark.whole
def test_what_hangs_in_generated_rooms_hangs_on_a_wall_and_is_there_already() -> None:
    hung = 0
    for seed in range(8):
        objects, place = objects_of(furnished(seed), [0.0] * len(furnished(seed).objects))
        found = find_carriers(objects, place, CONFIG)
        for obj in objects:
            carrier = found[obj.instance_id]
            if carrier.relation == "wall":
                hung += 1
                assert carrier.against is not None
                # pictures above an object at the wall hang as far off as its baseboard keeps that
                assert np.linalg.norm(wall_snap(obj, place, carrier)) <= 0.02
    assert hung > 20


@pytest.mark.whole
def test_compartments_of_generated_shelves_are_inside() -> None:
    relations = []
    for seed in range(12):
        made = furnished(seed)
        objects, place = objects_of(made, [0.0] * len(made.objects))
        found = find_carriers(objects, place, CONFIG)
        shelves = {obj.name: asset for obj, asset in zip(made.objects, objects, strict=True) if "bookshelf" in obj.category}
        relations += [found[asset.instance_id].relation for obj, asset in zip(made.objects, objects, strict=True) if obj.parent in shelves]
    assert len(relations) > 20
    assert relations.count("inside") == len(relations)


@pytest.mark.whole
@pytest.mark.parametrize("count", [40, 80])
def test_all_of_a_full_room_is_carried_the_same_way_every_time(count: int) -> None:
    made = furnished(1, count)
    offsets = [0.0] * len(made.objects)
    objects, place = objects_of(made, offsets)
    found = find_carriers(objects, place, CONFIG)
    assert len(found) >= count
    assert find_carriers(*objects_of(made, offsets), CONFIG) == found
    by_id = {obj.instance_id: obj for obj in objects}
    carried = [(by_id[name], by_id[c.parent_id], c.gap) for name, c in found.items() if c.parent_id is not None]
    assert carried
    for obj, parent, gap in carried:
        assert support_map(obj, parent, gap, 0.02, 30, CONFIG) is not None


@pytest.mark.parametrize(
    "values",
    [{"cell_m": 0.0}, {"base_m": 0.0}, {"reach_m": -0.1}, {"share": 1.5}, {"rest_quantile": float("nan")}, {"cable_m": float("inf")}],
)
def test_supports_that_cannot_be_are_refused(values: dict[str, float]) -> None:
    (field,) = values
    with pytest.raises(ValueError, match=f"^{field}: must be "):
        SupportConfig(**values)


def test_what_has_the_wrong_unit_takes_no_more_memory_than_a_hall() -> None:
    """A house of a kilometre and a box on it."""
    objects = [at(1, block(1000, 800, 3), 0, 0, 0), at(2, block(500, 500, 3), 0, 0, 3.05)]
    found = find_carriers(objects, room(), CONFIG)
    assert (found["0002"].relation, found["0002"].parent_id) == ("on", "0001")
    allowed = support_map(objects[1], objects[0], found["0002"].gap, 0.02, 30, CONFIG)
    assert allowed.shape == (61, 61)
    assert np.argwhere(allowed).tolist() == [[30, 30]]


def test_objects_without_volume_are_carried_like_others() -> None:
    """A sheet lies on a table, an upright sheet stands on it, a point lies on the floor."""
    parts = []
    for corners in (
        [[0, 0, 0], [0.3, 0, 0], [0.3, 0.3, 0], [0, 0.3, 0]],
        [[0, 0, 0], [0.3, 0, 0], [0.3, 0, 0.3], [0, 0, 0.3]],
        [[0, 0, 0]] * 4,
    ):
        parts.append([trimesh.Trimesh(np.array(corners, dtype=float), [[0, 1, 2], [0, 2, 3]], process=False)])
    objects = [at(0, parts[0], 0, 0, 0.77), BELOW, at(2, parts[1], -0.3, 0, 0.74), at(3, parts[2], 1, 1, 0.03)]
    found = find_carriers(objects, room(), CONFIG)
    assert [found[f"{i:04d}"].parent_id for i in range(4)] == ["0001", None, "0001", None]
    assert found["0003"].relation == "floor"
