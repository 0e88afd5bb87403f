"""Annotations that hold more than what they name: what the kind of the object tells is left out of its box."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from tasks.capture.instances.merged import own_part, set_apart
from tasks.capture.labels import Label, label_map
from tasks.capture.reading import Group
from tasks.geometry.meshes import Surface, surface_of
from tests.tasks.capture.test_hidden import grid


@given(height=st.floats(-0.05, 0.3), noise=st.sampled_from([0.0, 0.004]), side=st.floats(0.2, 0.6), seed=st.integers(0, 3))
def test_a_rug_is_flat_whatever_was_annotated_with_it(height: float, noise: float, side: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rug = grid((0.0, 0.0, height), (2.0, 1.4, height + 0.01))
    rug = rug + rng.normal(0.0, noise, rug.shape)
    sofa = grid((0.2, 0.2, height + 0.1), (0.2 + side, 0.2 + side, height + 0.5), 0.05)
    own = own_part(np.concatenate([rug, sofa]), "rug")
    assert own[: len(rug)].mean() >= 0.9
    assert np.ptp(rug[own[: len(rug)]][:, :2], axis=0) == pytest.approx(np.ptp(rug[:, :2], axis=0), abs=0.05)
    assert not own[len(rug) :].any()


@given(noise=st.floats(0.004, 0.015), seed=st.integers(0, 3))
def test_noise_makes_no_rug_thicker(noise: float, seed: int) -> None:
    """Its top is where half of its points are; as thick as a step, it would lift what stands on it."""
    rug = grid((0.0, 0.0, 0.02), (2.0, 1.4, 0.021))
    rug = rug + np.random.default_rng(seed).normal(0.0, noise, rug.shape)
    own = rug[own_part(rug, "rug")]
    assert len(own) > 0.6 * len(rug)
    assert np.quantile(own[:, 2], 0.99) <= 0.035  # boxes leave out as much
    assert np.ptp(own[:, :2], axis=0) == pytest.approx(np.ptp(rug[:, :2], axis=0), abs=0.06)


@pytest.mark.parametrize("category", ["table", "coffee table", "kitchen counter", "desk"])
def test_what_stands_on_a_table_is_none_of_it(category: str) -> None:
    table = grid((0.0, 0.0, 0.7), (1.4, 0.8, 0.74))
    legs = grid((0.0, 0.0, 0.0), (0.04, 0.04, 0.7))
    machine = grid((0.3, 0.3, 0.75), (0.6, 0.55, 1.05))
    own = own_part(np.concatenate([table, legs, machine]), category)
    assert own[: len(table) + len(legs)].all()
    assert not own[len(table) + len(legs) :][machine[:, 2] > 0.77].any()


def test_what_belongs_above_a_top_stays() -> None:
    """A desk with a shelf over half of it, a sofa with its back, a chair: all of them is theirs."""
    desk = np.concatenate([grid((0.0, 0.0, 0.7), (1.4, 0.8, 0.74)), grid((0.0, 0.4, 1.1), (1.4, 0.8, 1.2))])
    assert own_part(desk, "desk").all()
    seat_and_back = np.concatenate([grid((0.0, 0.0, 0.4), (0.5, 0.5, 0.45)), grid((0.0, 0.45, 0.45), (0.5, 0.5, 0.9))])
    for category in ("sofa", "chair", "thing"):
        assert own_part(seat_and_back, category).all()


def test_a_rolled_carpet_is_no_flat_one() -> None:
    roll = grid((0.0, 0.0, 0.0), (0.2, 0.2, 1.6))
    assert own_part(roll, "carpet").all()


@pytest.mark.parametrize("share", [0.3, 0.4, 0.45])
@pytest.mark.parametrize("raised", [0.02, 0.03])
def test_a_rug_that_lies_on_something_keeps_its_plan(share: float, raised: float) -> None:
    rug = grid((0.0, 0.0, 0.0), (2.0, 1.4, 0.01))
    rug[rug[:, 0] > 2.0 * (1 - share), 2] += raised
    assert np.ptp(rug[own_part(rug, "rug")][:, :2], axis=0) == pytest.approx([2.0, 1.4])


@pytest.mark.parametrize("degrees", [0.5, 1.0])
def test_a_rug_on_a_slope_keeps_its_plan(degrees: float) -> None:
    rug = grid((0.0, 0.0, 0.0), (3.0, 1.4, 0.01))
    rug[:, 2] += np.tan(np.radians(degrees)) * rug[:, 0]
    assert np.ptp(rug[own_part(rug, "rug")][:, :2], axis=0) == pytest.approx([3.0, 1.4], abs=0.06)


def scan_of(*objects: tuple[str, list[trimesh.Trimesh]]) -> tuple[list[Group], list[Label], Surface]:
    """Annotated objects of a scan mesh, each of some solids with triangles of 4 cm."""
    groups, parts, vertices, faces = [], [], 0, 0
    for number, (label, solids) in enumerate(objects):
        mesh = trimesh.util.concatenate([trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(s.vertices, s.faces, 0.04)) for s in solids])
        groups.append(
            Group(str(number), label, vertices + np.arange(len(mesh.vertices)), faces + np.arange(len(mesh.faces)), "labels.json")
        )
        parts.append(mesh)
        vertices, faces = vertices + len(mesh.vertices), faces + len(mesh.faces)
    return groups, [label_map()[label] for label, _ in objects], surface_of(parts)


RUG = trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [3.0, 2.4, 0.02]])
SOFA = trimesh.creation.box(bounds=[[0.4, 0.3, 0.02], [2.4, 1.2, 0.8]])
SIDE_TABLE = trimesh.creation.box(bounds=[[2.6, 0.4, 0.02], [2.95, 0.8, 0.5]])
CRUMB = trimesh.creation.box(bounds=[[0.5, 1.8, 0.02], [0.6, 1.9, 0.12]])


def test_furniture_that_was_annotated_with_its_rug_stands_on_it() -> None:
    groups, meanings, world = scan_of(("bath mat", [RUG, SOFA, SIDE_TABLE, CRUMB]), ("chair", [SOFA]))
    made, labels, notes = set_apart(groups, meanings, world)
    assert [(group.source_id, group.raw_label, label.category) for group, label in zip(made, labels, strict=True)] == [
        ("0", "bath mat", "mat"), ("1", "chair", "chair"), ("0.1", "geometry:sofa", "sofa"),
        ("0.2", "geometry:stool", "stool"),
    ]  # fmt: skip
    assert notes == [f"labels.json: 'bath mat' 0 has a {name} on it, which is 0.{k} now" for k, name in enumerate(("sofa", "stool"), 1)]
    for name in ("vertices", "faces"):
        parts = [getattr(made[k], name) for k in (0, 2, 3)]
        assert np.sort(np.concatenate(parts)).tolist() == getattr(groups[0], name).tolist(), "nothing is lost, nothing is in two"
    for group in made:
        assert np.isin(world.faces[group.faces], group.vertices).all() or group.source_id == "0"
    sofa = world.vertices[made[2].vertices]
    assert sofa.max(axis=0) == pytest.approx([2.4, 1.2, 0.8])
    assert sofa.min(axis=0) == pytest.approx([0.4, 0.3, 0.06], abs=0.05)


@pytest.mark.parametrize(
    ("label", "solids"),
    [("rug", [RUG]), ("rug", [RUG, CRUMB]), ("mat", [SOFA]), ("sofa", [RUG, SOFA]), ("tablecloth", [RUG, CRUMB])],
)
def test_what_does_not_stand_on_a_rug_stays_as_it_was_annotated(label: str, solids: list[trimesh.Trimesh]) -> None:
    groups, meanings, world = scan_of((label, solids))
    made, labels, notes = set_apart(groups, meanings, world)
    assert (list(made), labels, notes) == (groups, meanings, [])


WIDE_CABINET = trimesh.creation.box(bounds=[[0.0, 0.0, 0.05], [0.6, 0.6, 0.86]])
CORNER_SOFA = [
    trimesh.creation.box(bounds=[[0.2, 0.3, 0.02], [2.2, 1.1, 0.45]]),
    trimesh.creation.box(bounds=[[0.2, 1.1, 0.02], [1.0, 2.2, 0.45]]),
    trimesh.creation.box(bounds=[[0.2, 0.3, 0.45], [2.2, 0.5, 0.8]]),
]
HIGH_TABLE = trimesh.creation.box(bounds=[[0.8, 0.6, 0.6], [2.1, 1.4, 0.75]])
"""What is left of a table whose legs were lost."""


@pytest.mark.parametrize(("solids", "category"), [(CORNER_SOFA, "sofa"), ([HIGH_TABLE], "table")])
def test_what_stands_on_a_rug_is_called_by_what_it_looks_like(solids: list[trimesh.Trimesh], category: str) -> None:
    groups, meanings, world = scan_of(("rug", [RUG, *solids]))
    made, labels, _ = set_apart(groups, meanings, world)
    assert [label.category for label in labels] == ["rug", category]
    assert len(made) == 2


def kitchen(label: str, yaw: float, cabinets: int) -> tuple[list[Group], list[Label], Surface]:
    """A worktop of 2.4 m annotated with the first cabinet below it; fronts alone are seen. yaw: of the kitchen [rad]."""
    turn = trimesh.transformations.rotation_matrix(yaw, [0.0, 0.0, 1.0])

    def front(k: int) -> trimesh.Trimesh:
        return trimesh.creation.box(bounds=[[0.6 * k, 0.0, 0.05], [0.6 * k + 0.6, 0.03, 0.85]]).apply_transform(turn)

    top = trimesh.creation.box(bounds=[[0.0, 0.0, 0.86], [2.4, 0.62, 0.9]]).apply_transform(turn)
    return scan_of((label, [top, front(0)]), *(("kitchen cabinet", [front(k)]) for k in range(1, cabinets)))


@given(label=st.sampled_from(["kitchen cabinet", "cabinet", "kitchen counter", "worktop"]), yaw=st.floats(-3.0, 3.0))
def test_a_worktop_that_was_annotated_with_one_cabinet_is_one_of_its_own(label: str, yaw: float) -> None:
    groups, meanings, world = kitchen(label, yaw, 4)
    made, labels, notes = set_apart(groups, meanings, world)
    assert len(made) == 5
    assert len(notes) == 1
    assert made[-1].source_id == "0.1"
    assert labels[-1].category == "kitchen counter"
    assert labels[0].category == ("cabinet" if label == "cabinet" else "kitchen cabinet")
    slab, body = world.vertices[made[-1].vertices], world.vertices[made[0].vertices]
    assert slab[:, 2].min() > 0.84
    assert body[:, 2].max() < 0.86
    assert np.ptp(body[:, :2] @ [np.cos(yaw), np.sin(yaw)]) == pytest.approx(0.6, abs=1e-6)
    assert sorted([*made[0].vertices, *made[-1].vertices]) == groups[0].vertices.tolist(), "nothing is lost, nothing is in two"


@pytest.mark.parametrize(("label", "cabinets"), [("kitchen cabinet", 1), ("desk", 4)])
def test_a_top_stays_with_its_body_where_nothing_else_stands_below_it(label: str, cabinets: int) -> None:
    groups, meanings, world = kitchen(label, 0.0, cabinets)
    assert set_apart(groups, meanings, world) == (tuple(groups), meanings, [])


def test_a_cabinet_with_its_own_top_stays_whole() -> None:
    groups, meanings, world = scan_of(
        ("kitchen cabinet", [WIDE_CABINET]), ("kitchen cabinet", [WIDE_CABINET.copy().apply_translation([0.6, 0, 0])])
    )
    assert set_apart(groups, meanings, world)[2] == []


@pytest.mark.parametrize("category", ["book stack", "books", "vase"])
def test_things_on_two_boards_of_a_shelf_are_two(category: str) -> None:
    """The larger keeps the annotation's id, whichever is higher. Without a board between they are one, as are two beside each other."""
    board = trimesh.creation.box(bounds=[[0.0, 0.0, 0.5], [1.0, 0.3, 0.52]])
    small = trimesh.creation.box(bounds=[[0.1, 0.05, 0.2], [0.4, 0.25, 0.4]])
    large = trimesh.creation.box(bounds=[[0.1, 0.05, 0.521], [0.8, 0.25, 0.75]])
    groups, meanings, world = scan_of((category, [small, large]), ("bookshelf", [board]))
    made, labels, notes = set_apart(groups, meanings, world)
    assert [group.source_id for group in made] == ["0", "1", "0.1"]
    assert [label.category for label in labels] == [meanings[0].category, meanings[1].category, meanings[0].category]
    assert np.array_equal(np.sort(np.concatenate([made[0].vertices, made[2].vertices])), np.sort(groups[0].vertices))
    assert np.array_equal(np.sort(np.concatenate([made[0].faces, made[2].faces])), np.sort(groups[0].faces))
    assert world.vertices[made[0].vertices, 2].min() == pytest.approx(0.521)
    assert world.vertices[made[2].vertices, 2].max() == pytest.approx(0.4)
    assert notes == [f"labels.json: {category!r} 0 has a {meanings[0].category} on another board, which is 0.1 now"]
    beside = trimesh.creation.box(bounds=[[0.6, 0.05, 0.521], [0.9, 0.25, 0.8]])
    lower = trimesh.creation.box(bounds=[[0.1, 0.05, 0.521], [0.4, 0.25, 0.75]])
    for objects in (((category, [small, large]),), ((category, [lower, beside]), ("bookshelf", [board]))):
        groups, meanings, world = scan_of(*objects)
        assert set_apart(groups, meanings, world) == (tuple(groups), meanings, [])


def test_a_shelf_with_things_between_its_boards_is_one() -> None:
    boards = [trimesh.creation.box(bounds=[[0.0, 0.0, z], [1.0, 0.3, z + 0.02]]) for z in (0.2, 0.6)]
    books = trimesh.creation.box(bounds=[[0.1, 0.05, 0.221], [0.9, 0.25, 0.5]])
    groups, meanings, world = scan_of(("shelf", boards), ("books", [books]))
    assert set_apart(groups, meanings, world) == (tuple(groups), meanings, [])
