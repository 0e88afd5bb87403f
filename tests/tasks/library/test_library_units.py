"""Units and axes: stated by files, by metadata, or plausible; whatever they are, the same model comes out."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from tasks.geometry.meshes import surface_of
from tasks.geometry.transforms import Z_UP_TO_Y_UP, yaw_pose
from tasks.library.format import Axis, ReadModel
from tasks.library.metadata import ModelFacts
from tasks.library.units import canonical_parts, convention_of, unit_of_sizes
from tests.tasks.library.models import SIZE, chair, farthest

UNITS = st.sampled_from([0.001, 0.01, 0.0254, 0.3048, 1.0, 100.0])
UPS = st.sampled_from(["y", "z"])
CHAIR = chair()


def read_as(unit_m: float, up: str, yaw: float = 0.0) -> list[trimesh.Trimesh]:
    """The chair in a file's units and axes, away from the origin."""
    parts = [part.copy() for part in CHAIR]
    for part in parts:
        part.apply_transform((Z_UP_TO_Y_UP if up == "y" else np.eye(4)) @ yaw_pose(yaw, (3.0, -2.0, 1.0)))
        part.apply_scale(1.0 / unit_m)
    return parts


@given(UNITS, UPS)
def test_what_a_file_states_is_used_whatever_it_is(unit_m: float, up: Axis) -> None:
    model = ReadModel(read_as(unit_m, up), "usd", unit_m, up)
    convention = convention_of(model, ModelFacts(), "gizmo")
    assert (convention.unit_m, convention.unit_known, convention.up, convention.up_known) == (unit_m, "file", up, "file")
    made = canonical_parts(model, convention)
    assert farthest(made, CHAIR) < 1e-6
    low, high = surface_of(made).bounds
    assert np.allclose([*(low + high)[:2], low[2]], 0, atol=1e-9)


@given(UNITS, UPS, st.sampled_from([0, 1, 2, 3]))
def test_metadata_state_units_axes_and_front(unit_m: float, up: Axis, quarters: int) -> None:
    """The front of the turned chair is +x before its turn: an axis of the file, which the metadata name."""
    way = (Z_UP_TO_Y_UP if up == "y" else np.eye(4))[:3, :3] @ yaw_pose(0.5 * np.pi * quarters)[:3, 0]
    axis = int(np.argmax(np.abs(way)))
    front = ("+" if way[axis] > 0 else "-") + "xyz"[axis]
    model = ReadModel(read_as(unit_m, up, 0.5 * np.pi * quarters), "obj", None, None)
    convention = convention_of(model, ModelFacts(unit_m=unit_m, up=up, front=front), "gizmo")
    assert (convention.unit_known, convention.up_known, convention.front, convention.front_known) == (
        "metadata",
        "metadata",
        front,
        "metadata",
    )
    assert farthest(canonical_parts(model, convention), CHAIR) < 1e-6


@given(UNITS, UPS)
def test_stated_sides_tell_the_unit(unit_m: float, up: Axis) -> None:
    model = ReadModel(read_as(unit_m, up), "obj", None, up)
    convention = convention_of(model, ModelFacts(extents_m=(SIZE[2], SIZE[0], SIZE[1])), "gizmo")
    assert convention.unit_known == "metadata"
    assert convention.unit_m == pytest.approx(unit_m, rel=1e-3)


@given(st.tuples(*[st.floats(0.05, 3.0)] * 3), st.floats(1e-4, 1e3), st.permutations([0, 1, 2]))
def test_a_unit_is_found_again_whatever_the_order_of_sides(sides: tuple[float, ...], unit: float, order: list[int]) -> None:
    found = unit_of_sizes(np.array(sides)[order] / unit, sides)
    assert found == pytest.approx(unit, rel=1e-6)
    assert unit_of_sizes(np.array(sides), np.sort(sides) * [1.0, 1.0, 2.0]) is None


@pytest.mark.parametrize("category", ["chair", "gizmo"])
@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("unit_m", [0.001, 0.01, 1.0])
def test_where_nobody_says_the_usual_size_does(category: str, up: Axis, unit_m: float) -> None:
    model = ReadModel(read_as(unit_m, up), "obj", None, None)
    convention = convention_of(model, ModelFacts(), category)
    if category == "gizmo":
        assert (convention.unit_m, convention.unit_known, convention.up, convention.up_known) == (1.0, "assumed", "y", "assumed")
        return
    assert (convention.up, convention.up_known) == (up, "plausibility")
    assert convention.unit_m == pytest.approx(unit_m)
    assert convention.unit_known == ("assumed" if unit_m == 1.0 else "plausibility")
    assert ("read as" in convention.note) == (unit_m != 1.0)


def test_a_file_that_is_wrong_about_its_unit_is_not_believed() -> None:
    """GLB is in metres by the standard; a chair of 95 m is in centimetres all the same."""
    model = ReadModel(read_as(0.01, "z"), "glb", 1.0, "y", is_turned=True)
    convention = convention_of(model, ModelFacts(), "chair")
    assert (convention.unit_m, convention.unit_known) == (0.01, "plausibility")
    assert farthest(canonical_parts(model, convention), CHAIR) < 1e-6


def test_a_glb_whose_up_is_z_is_turned_back_where_metadata_say_so() -> None:
    """Its reader turned it from +Y up; coordinates in the file had +Z up."""
    model = ReadModel(read_as(1.0, "z"), "glb", 1.0, "y", is_turned=True)
    for part in model.parts:
        part.apply_transform(np.linalg.inv(Z_UP_TO_Y_UP))
    convention = convention_of(model, ModelFacts(up="z"), "chair")
    assert (convention.up, convention.up_known) == ("z", "metadata")
    assert farthest(canonical_parts(model, convention), CHAIR) < 1e-6


def test_a_front_that_points_up_is_none() -> None:
    model = ReadModel(read_as(1.0, "y"), "obj", None, "y")
    assert convention_of(model, ModelFacts(front="+y"), "chair").front == ""
    assert convention_of(model, ModelFacts(front="ahead"), "chair").front == ""
