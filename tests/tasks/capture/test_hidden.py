"""What a scan could not see of furniture: legs that it lost, fronts without bodies, and what must stay as it is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.capture import Instance, Shell
from tasks.candidates.closing import SolidField, closed_mesh, solid_field
from tasks.candidates.completion import Unseen
from tasks.capture.instances.boxes import oriented_box
from tasks.capture.instances.hidden import with_hidden_parts
from tasks.geometry.boxes import grown_box
from tasks.geometry.meshes import Surface
from tasks.geometry.transforms import flat, matrix, yaw_of, yaw_pose
from tests.samples import sample

Array = np.ndarray

ROOM = sample(Shell, walls=((0.0, 0.0, 4.0, 0.0), (4.0, 0.0, 4.0, 4.0), (4.0, 4.0, 0.0, 4.0), (0.0, 4.0, 0.0, 0.0)))
"""A room of 4 m by 4 m."""


def grid(low: tuple[float, ...], high: tuple[float, ...], step: float = 0.02) -> Array:
    """Points of a box, evenly spread [m], shape (n, 3)."""
    axes = [np.linspace(a, b, max(round((b - a) / step), 1) + 1) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def floor_without(low: tuple[float, float], high: tuple[float, float]) -> Array:
    """Points of the floor that is seen but for a rectangle [m], shape (n, 2)."""
    points = grid((0.0, 0.0, 0.0), (4.0, 4.0, 0.0))[:, :2]
    return points[~((points > low) & (points < high)).all(axis=1)]


def instance(category: str, points: Array, number: int = 0, probability: float | None = None) -> Instance:
    low, high = points.min(axis=0), points.max(axis=0)
    pose = yaw_pose(0.0, 0.5 * (low + high))
    return sample(
        Instance, instance_id=f"{number:04d}", category=category, is_structure=False, box_pose=flat(pose), box_size=tuple(high - low),
        hidden_m=None, category_probability=probability,
        found_by="geometry" if probability is not None else "scan",
    )  # fmt: skip


def whole(*objects: tuple[str, Array], floor: Array | None = None, probability: float | None = None) -> list[tuple[Array, Array]]:
    """Lowest and highest corner of every object with what is hidden of it [m]. probability: of their categories, where they are guesses."""
    rows = [instance(category, points, number, probability) for number, (category, points) in enumerate(objects)]
    made = with_hidden_parts(rows, [points for _, points in objects], floor_without((9, 9), (9, 9)) if floor is None else floor, ROOM)
    boxes = [grown_box(row.box_pose, row.box_size, row.hidden_m) for row in made]
    return [(pose[:3, 3] - 0.5 * size, pose[:3, 3] + 0.5 * size) for pose, size in boxes]


@given(seat=st.floats(0.1, 0.6), x=st.floats(0.6, 3.0), y=st.floats(0.6, 3.0), category=st.sampled_from(["chair", "offcie chair", "stool"]))
def test_legs_that_the_scan_lost_reach_the_floor(seat: float, x: float, y: float, category: str) -> None:
    ((low, high),) = whole((category, grid((x, y, seat), (x + 0.45, y + 0.45, seat + 0.45))))
    assert low == pytest.approx([x, y, 0.0])
    assert high == pytest.approx([x + 0.45, y + 0.45, seat + 0.45])


@pytest.mark.parametrize("category", ["kitchen cabinet", "bathroom cabinet", "dresser"])
def test_the_floor_before_a_plinth_says_nothing_and_that_behind_a_front_does(category: str) -> None:
    """Of a cabinet the front alone was seen, over a plinth that stands back by 6 cm; one that hangs at its wall shows the floor below, and
    no cabinet hangs so low that its feet may be lost."""
    low_one = 0.12 if category == "dresser" else 0.0  # which never hangs: seen on its feet, it stands on these
    for hidden_to, bottom, lowest in ((0.52, 0.2, 0.0), (0.3, 0.2, 0.2), (0.3, 0.12, low_one)):
        front = grid((0.52, 1.0, bottom), (0.58, 2.2, 0.86))
        floor = floor_without((-0.1, 0.9), (hidden_to, 2.3))
        ((low, high),) = whole((category, front), floor=floor)
        assert low[2] == pytest.approx(lowest, abs=1e-9), (hidden_to, bottom)
        assert high == pytest.approx([0.58, 2.2, 0.86])
    ((low, _),) = whole((category, grid((0.52, 1.0, 0.1), (0.58, 2.2, 0.86))), floor=floor_without((-0.1, 0.9), (0.52, 2.3)))
    assert low == pytest.approx([0.0, 1.0, 0.0], abs=1e-9)


@pytest.mark.parametrize(
    ("category", "top", "lowest"), [("cabinet", 1.0, 0.0), ("cabinet", 1.9, 1.89), ("shelf", 1.0, 0.99), ("sink", 1.0, 0.99)]
)
def test_a_cabinet_of_which_the_top_alone_was_seen_from_above_stands(category: str, top: float, lowest: float) -> None:
    """What hangs below the eyes would show its front as well; of what hangs above them nobody sees the top alone."""
    lid = grid((1.0, 0.02, top - 0.01), (1.8, 0.4, top))
    ((low, high),) = whole((category, lid), floor=floor_without((0.9, -0.1), (1.9, 0.5)))
    assert low[2] == pytest.approx(lowest, abs=1e-9)
    assert high[2] == pytest.approx(top)
    ((low, _),) = whole((category, lid))
    assert low[2] == pytest.approx(top - 0.01), "the floor was seen below it"


@pytest.mark.parametrize(("category", "turn"), [("kitchen counter", 0.0), ("table", None)])
def test_a_worktop_lies_along_its_wall_whatever_was_seen_of_it(category: str, turn: float | None) -> None:
    """Two corners of a worktop were not seen: the least box of the others is askew. A table may be."""
    slab = grid((0.05, 0.5, 0.86), (0.65, 3.5, 0.9))
    far, near = slab[:, 1] - 0.5, slab[:, 0] - 0.05
    slab = slab[np.abs(near - 0.15 - 0.1 * far) <= 0.151]
    pose, size = oriented_box(slab)
    assert abs(yaw_of(pose)) > 0.05
    row = sample(
        Instance, instance_id="0000", category=category, is_structure=False, box_pose=flat(pose), box_size=tuple(size), hidden_m=None
    )
    (made,) = with_hidden_parts([row], [slab], floor_without((-0.1, 0.4), (0.7, 3.6)), ROOM)
    assert yaw_of(matrix(made.box_pose)) == pytest.approx(yaw_of(pose) if turn is None else turn, abs=1e-9)
    box, extents = grown_box(made.box_pose, made.box_size, made.hidden_m)
    if turn is not None:
        assert box[:2, 3] - 0.5 * extents[:2] == pytest.approx([0.0, 0.5], abs=0.06)
        assert box[:2, 3] + 0.5 * extents[:2] == pytest.approx([0.65, 3.5], abs=0.03)
        assert made.box_volume_m3 == pytest.approx(float(np.prod(made.box_size)))


def test_furniture_on_a_platform_reaches_down_to_that() -> None:
    platform = grid((1.0, 1.0, 0.0), (3.0, 3.0, 0.18))
    (_, _), (low, _) = whole(("platform", platform), ("armchair", grid((1.5, 1.5, 0.3), (2.2, 2.2, 0.9))))
    assert low[2] == pytest.approx(0.18, abs=0.01)


def test_furniture_hides_the_platform_that_it_stands_on() -> None:
    """Of the platform's top only what is beside the armchair was seen; one that stands beside it reaches the floor."""
    platform = grid((1.0, 1.0, 0.0), (2.4, 2.4, 0.18))
    platform = platform[~((platform[:, :2] > 1.3) & (platform[:, :2] < 2.2)).all(axis=1)]
    on, beside = grid((1.3, 1.3, 0.4), (2.2, 2.2, 0.9)), grid((2.6, 1.3, 0.4), (3.5, 2.2, 0.9))
    (_, _), (low, _), (other, _) = whole(("platform", platform), ("armchair", on), ("armchair", beside))
    assert low == pytest.approx([1.3, 1.3, 0.18], abs=0.01)
    assert other == pytest.approx([2.6, 1.3, 0.0], abs=1e-9)


@pytest.mark.parametrize("category", ["mug", "pillow", "keyboard", "picture", "ceiling lamp", "kitchen counter", "box", "stove", "oven"])
def test_what_stands_on_furniture_or_hangs_stays_as_it_was_seen(category: str) -> None:
    points = grid((1.0, 1.0, 0.7), (1.4, 1.4, 0.9))
    ((low, high),) = whole((category, points))
    assert low == pytest.approx(points.min(axis=0))
    assert high == pytest.approx(points.max(axis=0))


@pytest.mark.parametrize("category", ["bathroom cabinet", "cabinet", "bookshelf", "upper kitchen cabinets"])
def test_a_cabinet_above_a_floor_that_was_seen_hangs(category: str) -> None:
    points = grid((0.0, 1.0, 0.6), (0.3, 1.6, 1.2))
    ((low, _),) = whole((category, points))
    assert low[2] == pytest.approx(0.6)
    ((low, _),) = whole((category, points), floor=floor_without((0.0, 1.0), (0.3, 1.6)))
    assert low[2] == pytest.approx(0.0), "where the floor is hidden below it, the cabinet itself hides it"


def test_what_stands_on_a_thin_top_does_not_carry_it() -> None:
    """A desk's top with a box on it, a seat with a pillow on it, and a chair over a rug: their legs were lost all the same."""
    top, box = grid((1.0, 1.0, 0.7), (2.2, 1.6, 0.74)), grid((1.1, 1.1, 0.74), (1.9, 1.5, 1.1))
    assert whole(("desk", top), ("box", box))[0][0][2] == pytest.approx(0.0)
    seat, pillow = grid((1.0, 1.0, 0.42), (1.45, 1.45, 0.9)), grid((1.05, 1.05, 0.44), (1.4, 1.4, 0.55))
    assert whole(("chair", seat), ("pillow", pillow))[0][0][2] == pytest.approx(0.0)
    low_seat, rug = grid((1.0, 1.0, 0.1), (1.5, 1.5, 0.9)), grid((0.5, 0.5, 0.0), (2.5, 2.5, 0.01))
    assert whole(("armchair", low_seat), ("rug", rug))[0][0][2] == pytest.approx(0.0)


@pytest.mark.parametrize("category", ["microwave", "shelf", "tv", "mug", "mini fridge", "toaster oven", "mini fridges"])
def test_what_is_put_on_furniture_is_not_drawn_to_the_wall(category: str) -> None:
    counter, put = grid((0.0, 1.0, 0.0), (0.6, 2.0, 0.9), 0.05), grid((0.25, 1.2, 0.9), (0.6, 1.7, 1.2))
    _, (low, high) = whole(("kitchen counter", counter), (category, put), floor=floor_without((0.0, 1.0), (0.6, 2.0)))
    assert low == pytest.approx(put.min(axis=0))
    assert high == pytest.approx(put.max(axis=0))


def test_nothing_is_drawn_to_the_wall_where_no_floor_was_seen_at_all() -> None:
    front = grid((0.5, 1.0, 0.0), (0.55, 1.6, 0.86))
    ((low, _),) = whole(("cabinet", front), floor=np.zeros((0, 2)))
    assert low[0] == pytest.approx(0.5)


def test_a_plural_is_mounted_as_its_singular() -> None:
    from tasks.mounting import mounting

    for name in ("kitchen cabinet", "cabinet", "wall cabinet", "chair", "bookshelf", "dish rack", "box"):
        plural = f"{name}es" if name.endswith("x") else f"{name}s"
        assert mounting(plural) == mounting(name) == mounting(f"upper {plural}")


def test_a_chair_that_lies_on_a_table_stays_on_it() -> None:
    table, chair = grid((1.0, 1.0, 0.0), (2.2, 2.2, 0.75)), grid((1.3, 1.3, 0.76), (1.75, 1.75, 1.2))
    assert whole(("table", table), ("chair", chair))[1][0][2] == pytest.approx(0.76)


@pytest.mark.whole
@given(depth=st.floats(0.02, 0.1), gap=st.floats(0.2, 0.6), yaw=st.sampled_from([0.0, 90.0]))
def test_a_front_before_a_wall_is_the_front_of_a_body(depth: float, gap: float, yaw: float) -> None:
    low, high = np.array([gap, 1.0, 0.02]), np.array([gap + depth, 1.6, 0.86])
    if yaw:  # before the other wall
        low[:2], high[:2] = low[1::-1], high[1::-1]
    ((body_low, body_high),) = whole(("kitchen cabinet", grid(low, high)), floor=floor_without((0.0, 0.0), tuple(high[:2])))
    assert np.delete(body_low, 1 if yaw else 0) == pytest.approx(np.delete(low, 1 if yaw else 0))
    assert body_low[1 if yaw else 0] == pytest.approx(0.0, abs=1e-9)
    assert body_high == pytest.approx(high)


def test_a_hood_is_as_deep_as_its_cabinets() -> None:
    hood = grid((0.2, 1.0, 1.5), (0.5, 1.6, 2.0))
    ((low, high),) = whole(("range hood", hood), floor=floor_without((0.0, 0.9), (0.6, 1.7)))
    assert low == pytest.approx([0.0, 1.0, 1.5], abs=1e-9)
    assert high == pytest.approx([0.5, 1.6, 2.0])


def test_a_front_whose_back_was_seen_is_no_body() -> None:
    """A folding screen half a metre before a wall, the floor behind it in sight, and one with a box behind it."""
    front = grid((0.5, 1.0, 0.0), (0.55, 1.6, 0.86))
    ((low, _),) = whole(("cabinet", front))
    assert low[0] == pytest.approx(0.5)
    behind = grid((0.1, 1.05, 0.0), (0.45, 1.55, 0.8), 0.04)
    (low, _), _ = whole(("cabinet", front), ("box", behind), floor=floor_without((0.0, 0.0), (0.6, 2.0)))
    assert low[0] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("base", "hidden"), [("legs", (0, 0, 0, 0, 0.42, 0)), ("body", (0, 0, 0, 0, 0.42, 0)), ("body", (0.5, 0, 0, 0, 0, 0))]
)
def test_a_crop_is_drawn_out_to_what_it_stands_on_and_leans_on(base: str, hidden: tuple[float, ...]) -> None:
    """A slab at the height of a seat, and a front: closed, they fill the box that they are said to have, and stand on all of it."""
    x = np.linspace(-0.225, 0.225, 24) if hidden[4] else np.linspace(-0.02, 0.02, 4)
    z = np.linspace(0.42, 0.47, 4) if hidden[4] else np.linspace(0.0, 0.8, 40)
    low, high = np.array([x[0], -0.225, z[0]]), np.array([x[-1], 0.225, z[-1]])
    import trimesh

    box = trimesh.creation.box(high - low, trimesh.transformations.translation_matrix(0.5 * (low + high))).subdivide_to_size(0.025)
    crop = Surface(np.asarray(box.vertices), np.asarray(box.faces), np.full((len(box.vertices), 3), 128, dtype=np.uint8))
    field = solid_field(crop, Unseen(hidden[:5], base))  # type: ignore[arg-type]
    vertices, faces = closed_mesh(field)
    made = trimesh.Trimesh(vertices, faces, process=False)
    assert made.is_watertight
    assert field.low == pytest.approx(low - [hidden[0], hidden[2], hidden[4]], abs=1e-9)
    assert made.bounds[0] == pytest.approx(field.low, abs=2 * field.step)
    foot = vertices[vertices[:, 2] < field.low[2] + 1.5 * field.step, :2]
    assert np.ptp(foot, axis=0) == pytest.approx((field.high - field.low)[:2], abs=0.2 * 0.45 + 2 * field.step)
    middle = np.array([[*(0.5 * (field.low + field.high))[:2], 0.2]])
    assert bool(made.contains(middle)[0]) == (base == "body"), "legs leave the space between them free"


def crop_of(*boxes: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Surface:
    """Closed boxes between corners [m], as a scan has them."""
    import trimesh

    parts = [
        trimesh.creation.box(np.subtract(b, a), trimesh.transformations.translation_matrix(np.add(a, b) / 2)).subdivide_to_size(0.03)
        for a, b in boxes
    ]
    whole = trimesh.util.concatenate(parts)
    return Surface(np.asarray(whole.vertices), np.asarray(whole.faces), np.full((len(whole.vertices), 3), 128, dtype=np.uint8))


def test_a_crop_that_would_topple_gets_feet() -> None:
    """A desk of which the scan has the top and one leg."""
    import trimesh

    crop = crop_of(((-0.6, -0.35, 0.68), (0.6, 0.35, 0.74)), ((-0.6, -0.35, 0.0), (-0.52, -0.27, 0.7)))
    feet = {}
    for stands in (False, True):
        field = solid_field(crop, Unseen(stands=stands))
        made = trimesh.Trimesh(*closed_mesh(field), process=False)
        foot = made.vertices[made.vertices[:, 2] < made.bounds[0, 2] + field.step, :2]
        feet[stands] = np.ptp(foot, axis=0)
    assert (feet[False] < 0.3).all(), "as it was seen it stands on its one leg"
    assert (feet[True] > [1.0, 0.5]).all()


@pytest.mark.parametrize("is_held", [False, True])
def test_a_top_is_whole_below_what_stood_on_it(is_held: bool) -> None:
    """A desk's top with a hole where a screen hid it, and a bay that is open at the back, too wide for one, below a keyboard."""
    frame = [((-0.6, -0.35, 0.7), (0.6, -0.15, 0.74)), ((-0.6, 0.0, 0.7), (-0.05, 0.35, 0.74)), ((0.45, -0.2, 0.7), (0.6, 0.35, 0.74))]
    crop = crop_of(*frame, ((-0.6, -0.2, 0.7), (-0.2, 0.1, 0.74)), ((0.0, -0.2, 0.7), (0.6, 0.0, 0.74)))
    held = ((-0.05, 0.0, 0.45, 0.35),) if is_held else ()
    field = solid_field(crop, Unseen(is_flat_topped=True, held=held))
    spots = {"hole": (-0.1, -0.08), "below the keyboard": (0.2, 0.2)}

    def filled(made: SolidField) -> dict[str, bool]:
        top = (made.values < 0).any(axis=2)
        return {name: bool(top[tuple(np.rint((np.array(at) - made.origin[:2]) / made.step).astype(int))]) for name, at in spots.items()}

    assert filled(solid_field(crop)) == dict.fromkeys(spots, False)
    assert filled(field) == {"hole": True, "below the keyboard": is_held}


@pytest.mark.parametrize(
    ("category", "low", "high"),
    [
        ("refrigerator", (1.0, 0.0, 0.85), (1.6, 0.6, 1.8)),
        ("chair", (1.0, 1.0, 0.88), (1.45, 1.05, 0.98)),
        ("floor lamp", (1.0, 1.0, 1.35), (1.1, 1.2, 1.6)),
    ],
)
def test_what_never_hangs_reaches_the_floor_however_little_of_it_was_seen(
    category: str, low: tuple[float, float, float], high: tuple[float, float, float]
) -> None:
    ((made, _),) = whole((category, grid(low, high)), floor=floor_without(low[:2], high[:2]))
    assert made[2] == pytest.approx(0.0)


def test_a_lamp_on_a_pole_has_a_foot_that_it_stands_on() -> None:
    from tasks.mounting import mounting

    assert mounting("floor lamp").base == "pole"
    ((low, high),) = whole(("floor lamp", grid((1.0, 1.0, 1.35), (1.1, 1.2, 1.6))))
    assert high[:2] - low[:2] == pytest.approx([0.3, 0.3])
    assert 0.5 * (high[:2] + low[:2]) == pytest.approx([1.05, 1.1])


def test_a_crop_of_a_shade_is_completed_by_a_pole_and_a_foot() -> None:
    """It stands, its pole is in its middle, and between shade and foot there is nothing else."""
    import trimesh

    shade = trimesh.creation.cylinder(0.15, 0.25, transform=trimesh.transformations.translation_matrix([0.0, 0.0, 1.45])).subdivide()
    crop = Surface(np.asarray(shade.vertices), np.asarray(shade.faces), np.full((len(shade.vertices), 3), 128, dtype=np.uint8))
    field = solid_field(crop, Unseen((0.0, 0.0, 0.0, 0.0, 1.325), "pole", stands=True))
    vertices, faces = closed_mesh(field)
    made = trimesh.Trimesh(vertices, faces, process=False)
    assert made.is_watertight
    assert made.bounds[0, 2] == pytest.approx(0.0, abs=2 * field.step)
    pole = made.section([0, 0, 1], [0, 0, 0.7])
    assert pole is not None
    assert np.ptp(pole.bounds, axis=0)[:2].max() < 0.1
    foot = made.vertices[made.vertices[:, 2] < 0.5 * field.step]
    assert np.ptp(foot[:, :2], axis=0).min() > 0.2
    assert np.hypot(*made.center_mass[:2]) < 0.03


def test_a_worktop_of_which_the_edge_was_seen_reaches_the_wall() -> None:
    cabinet, edge = grid((0.0, 1.0, 0.0), (0.6, 2.6, 0.86), 0.05), grid((0.45, 1.0, 0.86), (0.6, 2.6, 0.9))
    _, (low, high) = whole(("kitchen cabinet", cabinet), ("kitchen counter", edge), floor=floor_without((0.0, 1.0), (0.6, 2.6)))
    assert low == pytest.approx([0.0, 1.0, 0.86], abs=1e-9)
    assert high == pytest.approx(edge.max(axis=0))


def test_the_box_of_a_leaf_that_was_turned_to_its_wall_leaves_stray_points_out() -> None:
    rng = np.random.default_rng(0)
    leaf = np.column_stack([rng.uniform(1.0, 1.8, 4000), rng.normal(0.0, 0.01, 4000), rng.uniform(0.0, 2.0, 4000)])
    points = np.concatenate([leaf, [[0.0, 0.9, 1.0], [2.9, -0.5, 1.0], [1.4, 0.8, 1.9]]])
    row = instance("door", leaf)
    corners = np.array([[x, y, z] for x in (0.95, 1.85) for y in (-0.05, 0.05) for z in (0.0, 2.03)])
    (made,) = with_hidden_parts([row], [points], np.zeros((0, 2)), ROOM, {0: corners})
    assert made.box_size == pytest.approx((0.8, 0.05, 2.0), abs=0.04)


@given(degrees=st.floats(-8.0, 8.0), along=st.floats(0.4, 3.6), depth=st.floats(0.03, 0.1), gap=st.floats(0.1, 0.5))
def test_a_front_that_is_askew_reaches_its_wall_and_not_beyond_it(degrees: float, along: float, depth: float, gap: float) -> None:
    """Wherever along a long wall it hangs: how far the wall's ends are does not matter."""
    pose, size = yaw_pose(np.radians(degrees), (gap + 0.5 * depth, along, 1.8)), (depth, 0.5, 0.6)
    row = sample(
        Instance, instance_id="0000", category="wall cabinet", is_structure=False, box_pose=flat(pose), box_size=size, hidden_m=None
    )
    points = pose[:3, 3] + (grid((0.0, 0.0, 0.0), size) - 0.5 * np.array(size)) @ pose[:3, :3].T
    (made,) = with_hidden_parts([row], [points], floor_without((-0.1, -0.1), (1.0, 4.1)), ROOM)
    assert made.hidden_m is not None
    assert made.hidden_m[1:4] == (0.0, 0.0, 0.0)
    assert (gap + 0.5 * depth) / np.cos(np.radians(degrees)) - 0.5 * depth == pytest.approx(made.hidden_m[0])


def test_the_floor_in_the_bend_of_a_sofa_is_not_below_it() -> None:
    bent = np.concatenate([grid((0.5, 0.5, 0.12), (2.7, 1.4, 0.7), 0.04), grid((0.5, 1.4, 0.12), (1.4, 2.3, 0.7), 0.04)])
    floor = floor_without((0.5, 0.5), (2.7, 2.3))
    in_bend = grid((1.5, 1.5, 0.0), (2.7, 2.3, 0.0))[:, :2]
    ((low, _),) = whole(("sofa", bent), floor=np.concatenate([floor, in_bend]))
    assert low[2] == pytest.approx(0.0)
    ((low, _),) = whole(("sofa", bent), floor=np.concatenate([floor, grid((0.5, 0.5, 0.0), (1.4, 2.3, 0.0))[:, :2]]))
    assert low[2] == pytest.approx(0.12), "a sofa on feet, with the floor seen below it"


@pytest.mark.parametrize("category", ["kitchen island", "table"])
def test_a_worktop_lies_on_the_cabinets_of_which_the_fronts_alone_were_seen(category: str) -> None:
    """By whichever name; over one front of four it stands by itself, as over stools of which the same was seen."""
    slab, floor = grid((0.0, 0.5, 0.84), (0.62, 2.9, 0.88)), floor_without((-0.1, 0.4), (0.62, 3.0))
    fronts = [grid((0.55, 0.5 + 0.6 * i, 0.1), (0.6, 1.1 + 0.6 * i, 0.83)) for i in range(4)]
    for carriers, count, lowest in (("kitchen cabinet", 4, 0.84), ("kitchen cabinet", 1, 0.0), ("stool", 4, 0.0)):
        low, high = whole((category, slab), *((carriers, front) for front in fronts[:count]), floor=floor)[0]
        assert low == pytest.approx([0.0, 0.5, lowest], abs=1e-9), (carriers, count)
        assert high == pytest.approx([0.62, 2.9, 0.88])


@pytest.mark.parametrize(
    "neighbors",
    [
        [("dresser", grid((1.29, 0.5, 0.0), (1.8, 1.9, 0.72)))],  # beside it, a little in its box
        [("washing machine", grid((1.2, 0.5, 0.0), (1.25, 1.1, 0.69)))],  # below one half of it
        [("file cabinet", grid((1.2, 0.5 + at, 0.0), (1.25, 0.9 + at, 0.63))) for at in (0.0, 1.0)],  # rolled under it, apart from it
    ],
)
def test_a_table_keeps_its_legs_beside_and_over_what_does_not_carry_it(neighbors: list[tuple[str, Array]]) -> None:
    slab = grid((0.5, 0.5, 0.7), (1.3, 1.9, 0.74))
    low, _ = whole(("table", slab), *neighbors, floor=floor_without((0.4, 0.4), (1.4, 2.0)))[0]
    assert low[2] == pytest.approx(0.0, abs=1e-9)


def test_a_cabinet_is_low_over_what_it_stands_on() -> None:
    stage = grid((0.0, 0.0, 0.0), (2.0, 3.0, 0.18))
    front = grid((0.52, 1.0, 0.3), (0.58, 2.2, 1.0))
    (low, _), _ = whole(("kitchen cabinet", front), ("platform", stage))
    assert low[2] == pytest.approx(0.18, abs=0.02)


NO_FLOOR = np.zeros((0, 2))
SLAB, BACK, STRIP = grid((1.0, 1.0, 0.7), (2.0, 1.6, 0.74)), grid((1.0, 1.0, 0.5), (1.4, 1.5, 0.9)), grid((0.0, 1.0, 1.0), (0.05, 1.5, 1.3))


@pytest.mark.parametrize(
    ("points", "floor", "lowest"),
    [
        (SLAB, None, 0.0),  # as a table's top: the floor below is seen between legs
        (BACK, NO_FLOOR, 0.0),  # its lower part was hidden
        (BACK, None, 0.5),  # the floor was seen below: nobody knows what holds it
        (STRIP, NO_FLOOR, 1.0),  # it hangs on the wall
        (grid((1.0, 1.0, 1.5), (1.4, 1.5, 1.9)), NO_FLOOR, 1.5),  # nothing stands so high
    ],
)  # fmt: skip
def test_what_geometry_could_not_name_stands_on_what_of_it_was_hidden(points: Array, floor: Array | None, lowest: float) -> None:
    ((low, high),) = whole(("object", points), floor=floor, probability=0.6)
    assert low[2] == pytest.approx(lowest, abs=1e-9)
    assert high == pytest.approx(points.max(axis=0))
    ((named_low, _),) = whole(("object", points), floor=floor)
    assert named_low == pytest.approx(points.min(axis=0)), "what people called an object is nothing of the kind"


def test_what_has_no_name_does_not_reach_through_what_stands_below_it() -> None:
    """Over a sofa far below it, and on a box right below it."""
    for top in (0.4, 0.68):
        (low, _), _ = whole(
            ("object", BACK + np.array([0.0, 0.0, 0.2])),
            ("object", grid((0.9, 0.9, 0.0), (1.5, 1.6, top))),
            floor=NO_FLOOR,
            probability=0.6,
        )
        assert low[2] == pytest.approx(0.7)


def test_what_was_found_on_furniture_is_no_furniture() -> None:
    """A nameless thing on a sideboard, whose top was seen nowhere but beside it, and of which nothing below was seen."""
    row = dataclasses.replace(instance("object", BACK, probability=0.6), found_by="classical")
    (made,) = with_hidden_parts([row], [BACK], NO_FLOOR, ROOM)
    assert made.hidden_m == (0.0,) * 6
