"""Storeys of a scan: all of its surface, once; instances whole or cut; textures, colors and frames with what they show."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from PIL import Image

from tasks.capture.labels import label_map
from tasks.capture.reading import FrameSource, Reading, groups_of
from tasks.capture.storeys.levels import Levels, StoreyConfig, levels
from tasks.capture.storeys.pieces import Storey, frames_of, storeys_of
from tasks.geometry.meshes import surface_of
from tasks.geometry.transforms import inverse, translation, yaw_pose
from tasks.geometry.triangles import surface_area
from tests.tasks.capture.storeys.houses import House, house_of

HOUSE = house_of(2, (7.0, 9.0), 2.5, 0.3)
TO_WORLD = translation([3.0, -1.0, 0.5]) @ yaw_pose(0.7)
"""The house stands turned and moved in its scan."""


def reading_of(house: House) -> Reading:
    """The house as a scan whose files name its instances, in a frame of its own."""
    surface = house.surface.transformed(inverse(TO_WORLD))
    named = [(str(10 + number), label, np.flatnonzero(house.instance == number)) for number, label in enumerate(house.labels)]
    return Reading(surface, groups=groups_of(named, house.instance, surface))


def divided(reading: Reading) -> tuple[tuple[Storey, ...], Levels]:
    assert reading.surface is not None
    found = levels(reading.surface.transformed(TO_WORLD), StoreyConfig())
    meanings = [label_map()[group.raw_label] for group in reading.groups or ()]
    return storeys_of(reading, meanings, TO_WORLD, found), found


def area(reading: Reading) -> float:
    assert reading.surface is not None
    return surface_area(reading.surface.vertices, reading.surface.faces)


def test_all_of_the_surface_is_in_one_storey_or_the_other() -> None:
    reading = reading_of(HOUSE)
    storeys, found = divided(reading)
    assert [storey.number for storey in storeys] == [0, 1]
    assert [storey.floor for storey in storeys] == list(found.floors)
    assert sum(area(storey.reading) for storey in storeys) == pytest.approx(area(reading), rel=1e-9)
    kept = {tuple(point) for storey in storeys for point in storey.reading.surface.vertices.tolist()}
    assert {tuple(point) for point in reading.surface.vertices.tolist()} <= kept  # to the bit: nothing was moved


def test_instances_keep_number_and_label_and_are_whole_but_for_walls() -> None:
    reading = reading_of(HOUSE)
    storeys, found = divided(reading)
    where: dict[str, list[int]] = {}
    for storey in storeys:
        own = storey.reading
        for group in own.groups:
            where.setdefault(group.source_id, []).append(storey.number)
            original = next(other for other in reading.groups if other.source_id == group.source_id)
            assert group.raw_label == original.raw_label
            assert len(group.vertices) == len(original.vertices)
            assert surface_area(own.surface.vertices, own.surface.faces[group.faces]) == pytest.approx(
                surface_area(reading.surface.vertices, reading.surface.faces[original.faces]), rel=1e-9
            )
    truth = {str(10 + number): [int(HOUSE.storey[HOUSE.instance == number][0])] for number in range(len(HOUSE.labels))}
    assert where == truth
    (stairs,) = (group for group in storeys[0].reading.groups if group.raw_label == "stairs")
    top = (storeys[0].reading.surface.transformed(TO_WORLD).vertices[stairs.vertices, 2]).max()
    assert top > found.cuts[0]  # they reach across, and are not cut


def test_a_wall_of_two_storeys_is_cut_and_is_an_instance_in_both() -> None:
    """One annotation for the walls of both floors, as people draw them."""
    walls = [number for number, label in enumerate(HOUSE.labels) if label == "wall"]
    instance = np.where(np.isin(HOUSE.instance, walls), walls[0], HOUSE.instance)
    reading = reading_of(dataclasses.replace(HOUSE, instance=instance))
    kept = tuple(group for group in reading.groups if len(group.vertices))
    reading = dataclasses.replace(reading, groups=kept)
    storeys, found = divided(reading)
    for storey in storeys:
        (wall,) = (group for group in storey.reading.groups if group.source_id == str(10 + walls[0]))
        height = storey.reading.surface.transformed(TO_WORLD).vertices[wall.vertices, 2]
        assert (found.storey_of(np.array([np.median(height)])) == storey.number).all()
    assert sum(area(storey.reading) for storey in storeys) == pytest.approx(area(reading), rel=1e-9)


def test_textures_stay_where_they_were_on_the_surface() -> None:
    plain = HOUSE.surface.to_trimesh()
    image = Image.fromarray(np.random.default_rng(0).integers(0, 256, (16, 16, 3)).astype(np.uint8))
    slope = np.array([[0.1, 0.0], [0.02, 0.1], [0.03, 0.05]])
    visual = trimesh.visual.TextureVisuals(uv=plain.vertices @ slope, material=trimesh.visual.material.PBRMaterial(baseColorTexture=image))
    part = trimesh.Trimesh(plain.vertices, plain.faces, process=False, visual=visual)
    part.apply_transform(inverse(TO_WORLD))
    part.metadata["name"] = "scan_0"
    storeys, _ = divided(Reading(surface_of([part]), parts=(part,)))
    assert sum(own.area for storey in storeys for own in storey.reading.parts) == pytest.approx(part.area, rel=1e-9)
    for storey in storeys:
        (own,) = storey.reading.parts
        assert own.visual.material.baseColorTexture is image
        world = own.vertices @ TO_WORLD[:3, :3].T + TO_WORLD[:3, 3]
        assert own.visual.uv == pytest.approx(world @ slope, abs=1e-9)


def frame(number: int, height: float | None) -> FrameSource:
    pose = None if height is None else inverse(TO_WORLD) @ translation([1.0, 1.0, height])
    lens = (100.0, 100.0, 50.0, 50.0)
    return FrameSource(f"{number:06d}", f"{number}.jpg", None, 100, 100, lens, None, lens, 1000.0, pose, lambda: np.zeros((1, 1, 3)), None)


def test_frames_are_those_of_the_storey_in_which_their_camera_was() -> None:
    frames = [frame(0, 1.5), frame(1, 4.4), frame(2, None), frame(3, 0.2), frame(4, 2.6), frame(5, 9.0)]
    own = frames_of(frames, TO_WORLD, Levels((0.0, 2.8, 5.6), (2.7, 5.5)))
    assert [[each.frame_id for each in part] for part in own] == [["000000", "000003", "000004"], ["000001"], ["000005"]]
