"""Small objects in the stage: a box on a table that the scan's files do not name, or name as a part of the table."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from schemas.capture import Instance
from tasks.calls.ledger import Recollection
from tasks.capture import CaptureConfig, find_scans, run
from tasks.capture.instances.rows import scanned_solid
from tasks.capture.instances.views import run_lengths
from tasks.capture.labels import label_map
from tasks.capture.leveling import read_scan
from tasks.capture.reading import Group
from tasks.capture.small_objects.additions import Making, SmallObjectsConfig, Unsought, with_small_objects
from tasks.capture.small_objects.classical import ClassicalConfig
from tasks.capture.small_objects.consensus import ConsensusConfig
from tasks.capture.small_objects.detectors import CommandedDetector, GroundingDino
from tasks.capture.small_objects.items import AskedItems
from tasks.capture.small_objects.joining import NewInstance
from tasks.capture.small_objects.learned import LearnedConfig
from tasks.capture.small_objects.segmenters import Sam2
from tasks.capture.small_objects.supports import SupportSlab
from tasks.geometry.meshes import Surface, load_glb, read_points, surface_of
from tasks.geometry.transforms import inverse, matrix, transform_points, translation, yaw_pose
from tasks.stage import Context, Outcome
from tests.capture_scans import OBJECTS, SCAN_FROM_WORLD, BoxRoom, box_room, well_formed, write_scannet
from tests.tasks.calls.servers import Server, refuses, says, server

__all__ = ["server"]

TABLE, BOX = OBJECTS[0], OBJECTS[3]


@pytest.fixture(scope="module")
def room() -> BoxRoom:
    return box_room()


def captured(folder: Path, config: CaptureConfig | None = None, ledger: Recollection | None = None) -> Outcome:
    (scan,), errors = find_scans(folder, "auto")
    assert not errors
    context = Context(scan.scene_id, "capture", 3, {}, ledger=ledger or Recollection())
    return well_formed(run(scan=scan, context=context, config=config or CaptureConfig()))


def one_found(outcome: Outcome, by: str = "classical") -> Instance:
    (found,) = [row for row in outcome.rows["instances"] if row.found_by == by]
    return found


def assert_is_the_box(outcome: Outcome, found: Instance, by: str = "classical") -> None:
    """Its points are on the true box, all that frames show of it, and masks show it in its color."""
    _, center, size, yaw = BOX
    points = transform_points(read_points(outcome.blobs[found.points_blob])[0], inverse(yaw_pose(yaw, center)))
    assert np.abs(points).max(axis=0) == pytest.approx(np.array(size) / 2, abs=0.02)
    assert np.abs(points[:, 2] - size[2] / 2).min() < 0.005, "its top"
    assert found.category_probability is not None
    assert 0 <= found.category_probability <= 1
    assert found.raw_label == f"{by}:{found.category}"
    masks = [mask for mask in outcome.rows["masks"] if mask.instance_id == found.instance_id]
    assert [mask.frame_id for mask in sorted(masks, key=lambda mask: -mask.score)] == list(found.best_frames)
    assert 1 <= len(masks) <= CaptureConfig().views_per_instance
    for mask in masks:
        x0, y0, x1, y1 = mask.pixel_box
        pixels = np.repeat(np.arange(len(mask.run_lengths)) % 2 == 1, mask.run_lengths).reshape(y1 - y0, x1 - x0)
        assert mask.found_by == by
        assert pixels.sum() == mask.pixel_count
        assert run_lengths(pixels) == mask.run_lengths
        assert mask.visible_share > 0.5
    assert found.view_blob in outcome.blobs


def test_what_the_files_do_not_name_is_found(tmp_path: Path, room: BoxRoom) -> None:
    outcome = captured(write_scannet(tmp_path / "scene0001_00", room, labels=room.labels[:-1]))
    found = one_found(outcome)
    assert_is_the_box(outcome, found)
    assert outcome.rows["scenes"][0].instance_count == len(outcome.rows["instances"]) == len(room.labels)
    assert {row.found_by for row in outcome.rows["instances"] if row is not found} == {"file"}
    assert {mask.found_by for mask in outcome.rows["masks"] if mask.instance_id != found.instance_id} == {"surface"}
    assert "1 small object that the scan does not name was found by classical" in outcome.degradations
    assert found.mesh_blob is not None
    own = surface_of(load_glb(outcome.blobs[found.mesh_blob])).vertices
    true = room.surface.vertices[room.instance == len(room.labels) - 1]
    assert np.abs(own[:, None] - true[None]).sum(axis=2).min(axis=1).max() < 1e-4, "faces of the scan mesh, the box's own"
    assert len(own) > 0.8 * (true[:, 2] > TABLE[2][2] + 0.01).sum(), "those that stand on the table"


def test_what_is_annotated_as_a_part_of_the_table_becomes_its_own(tmp_path: Path, room: BoxRoom) -> None:
    table, box = room.labels.index("table"), len(room.labels) - 1
    together = dataclasses.replace(room, instance=np.where(room.instance == box, table, room.instance), labels=room.labels[:-1])
    outcome = captured(write_scannet(tmp_path / "scene0001_00", together))
    plain = captured(tmp_path / "scene0001_00", CaptureConfig(small_objects=SmallObjectsConfig(provider=Unsought())))
    assert_is_the_box(outcome, one_found(outcome))
    before, after = (next(row for row in each.rows["instances"] if row.category == "table") for each in (plain, outcome))
    of_table, of_both = (read_points(each.blobs[row.points_blob])[0][:, 2] for each, row in ((outcome, after), (plain, before)))
    assert (of_both > TABLE[2][2] + 0.05).mean() > 0.05
    assert (of_table > TABLE[2][2] + 0.05).mean() < 0.005, "nothing of the box is the table's any more"


def test_what_is_named_is_not_found_again(tmp_path: Path, room: BoxRoom) -> None:
    """With all names, rows are those of a scan on which nobody looks for small objects, to the byte."""
    folder = write_scannet(tmp_path / "scene0001_00", room)
    outcome = captured(folder)
    plain = captured(folder, CaptureConfig(small_objects=SmallObjectsConfig(provider=Unsought())))
    assert outcome.rows == plain.rows
    assert outcome.blobs == plain.blobs


def test_who_cannot_look_says_so(tmp_path: Path, room: BoxRoom) -> None:
    outcome = captured(write_scannet(tmp_path / "scene0001_00", room, frames="none", labels=room.labels[:-1]))
    assert all(row.found_by == "file" for row in outcome.rows["instances"])
    assert "small objects were not looked for: no frame has a pose and depth" in outcome.degradations
    unsought = CaptureConfig(small_objects=SmallObjectsConfig(provider=Unsought()))
    assert not any("small objects" in line for line in captured(tmp_path / "scene0001_00", unsought).degradations)


def test_a_frame_that_cannot_be_read_costs_a_line_and_no_scan(tmp_path: Path, room: BoxRoom) -> None:
    """A frame that nobody needs for a crop may be broken, as before anybody looked for small objects."""
    folder = write_scannet(tmp_path / "scene0001_00", room, labels=room.labels[:-1])
    before = captured(folder)
    best = {name for row in before.rows["instances"] for name in row.best_frames[:1]}
    frame = next(row for row in before.rows["frames"] if row.frame_id not in best)
    path = folder / frame.color_file
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    outcome = captured(folder)
    assert_is_the_box(outcome, one_found(outcome))
    told = [line for line in outcome.degradations if line.startswith(f"small objects are looked for without frame {frame.frame_id}: ")]
    assert len(told) == 1


def test_frames_without_depth_are_no_frames_that_are_looked_at(tmp_path: Path, room: BoxRoom) -> None:
    """Of a walk in which every other frame has depth those that have it are chosen."""
    config = CaptureConfig(max_view_frames=6)
    folder = write_scannet(tmp_path / "scene0001_00", room, labels=room.labels[:-1])
    (scan,), _ = find_scans(folder, "auto")
    reading = read_scan(scan)
    halved = [dataclasses.replace(frame, depth=None, depth_size=None) if i % 2 == 0 else frame for i, frame in enumerate(reading.frames)]
    assert reading.surface is not None
    assert reading.groups is not None
    labels = label_map(None)
    meanings = [labels[group.raw_label] for group in reading.groups]
    pose = inverse(SCAN_FROM_WORLD)
    world = reading.surface.transformed(pose)
    solids = [scanned_solid(world, group) for group in reading.groups]
    all_of_them = with_small_objects(
        reading.groups, meanings, solids, world, halved, pose, labels, Context(scan.scene_id, "capture", 3, {}), config.small_objects,
        most_frames=6, most_views=3,
    )  # fmt: skip
    assert len(all_of_them.finders) == 1
    assert {sight.frame % 2 for sight in all_of_them.sights} == {1}


def test_every_vertex_and_face_has_one_owner_at_most(tmp_path: Path) -> None:
    """Two boxes that nobody named stand side by side on a table that has the vertices of one, a hand from a box that is named."""
    table, _, _, box = OBJECTS
    beside = ("box", (0.55, 0.45, 0.8), (0.2, 0.2, 0.2), 0.0)
    named = ("box", (1.2, 0.5, 0.78), (0.16, 0.2, 0.16), 0.0)
    room = box_room((table, named, box, beside))
    count = len(room.labels)
    merged = dataclasses.replace(room, instance=np.where(room.instance == count - 1, count - 4, room.instance), labels=room.labels[:-1])
    folder = write_scannet(tmp_path / "scene0001_00", merged, labels=room.labels[: count - 2])
    (scan,), _ = find_scans(folder, "auto")
    reading = read_scan(scan)
    assert reading.surface is not None
    assert reading.groups is not None
    labels, pose = label_map(None), inverse(SCAN_FROM_WORLD)
    world = reading.surface.transformed(pose)
    solids = [scanned_solid(world, group) for group in reading.groups]
    seen = with_small_objects(
        reading.groups, [labels[group.raw_label] for group in reading.groups], solids, world, reading.frames, pose, labels,
        Context(scan.scene_id, "capture", 3, {}), SmallObjectsConfig(provider=ClassicalConfig()), most_frames=60, most_views=3,
    )  # fmt: skip
    assert len(seen.finders) == 2
    for part in ("vertices", "faces"):
        owned = np.concatenate([getattr(group, part) for group in seen.groups])
        assert len(np.unique(owned)) == len(owned), part
    kept = next(group for group in seen.groups if group.source_id == reading.groups[count - 3].source_id)
    assert np.array_equal(kept.vertices, reading.groups[count - 3].vertices), "what is named keeps all that it has"
    for number in seen.finders:
        own, center = seen.groups[number], seen.solids[number].points.mean(axis=0)
        true = min((count - 2, count - 1), key=lambda i: float(np.linalg.norm(world.vertices[room.instance == i].mean(axis=0) - center)))
        assert (room.instance[own.vertices] == true).mean() > 0.95, "its own, not its neighbor's"
        assert np.isin(world.faces[own.faces], own.vertices).all()


def test_the_same_scan_gives_the_same_bytes(tmp_path: Path, room: BoxRoom) -> None:
    folder = write_scannet(tmp_path / "scene0001_00", room, labels=room.labels[:-1])
    first, second = captured(folder), captured(folder)
    assert first.rows == second.rows
    assert first.blobs == second.blobs


def test_boxes_are_to_the_instances_frame(tmp_path: Path, room: BoxRoom) -> None:
    """What stands on the table stands on it: its box begins at the table's top, give or take noise."""
    outcome = captured(write_scannet(tmp_path / "scene0001_00", room, labels=room.labels[:-1]))
    found = one_found(outcome)
    low = matrix(found.box_pose)[2, 3] - 0.5 * found.box_size[2] - (found.hidden_m[4] if found.hidden_m else 0.0)
    assert low == pytest.approx(TABLE[1][2] + 0.5 * TABLE[2][2], abs=0.01)


def by_color(folder: Path, color: np.ndarray, label: str = "book") -> str:
    """A program that detects what is painted in a color, and draws its mask; a command line that calls it. label: What it says it is."""
    program = folder / "detects.py"
    program.write_text(f"""import json, sys
import numpy as np
from PIL import Image
image = np.asarray(Image.open(sys.argv[1]).convert("RGB")) + 1.0
paint = np.array({color.tolist()}) + 1.0
mask = np.abs(np.log(image / image.sum(axis=2, keepdims=True)) - np.log(paint / paint.sum())).max(axis=2) < 0.2  # in any light
assert "book" in sys.argv[2].split(", ")
found = {{"boxes": [], "labels": [], "scores": [], "masks": []}}
if mask.sum() > 20:
    rows, columns = np.nonzero(mask)
    flat = np.concatenate([[False], mask.T.ravel(), [not mask.T.ravel()[-1]]])
    runs = np.diff(np.concatenate([[0], np.flatnonzero(flat[1:] != flat[:-1])]))
    found["boxes"].append([int(v) for v in (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)])
    found["labels"].append({label!r})
    found["scores"].append(0.75)
    found["masks"].append({{"size": list(mask.shape), "counts": [int(v) for v in runs]}})
json.dump(found, open(sys.argv[3], "w"))
""")
    return f'"{sys.executable}" {program} {{image}} {{names}} {{out}}'


def learned(**settings: Any) -> CaptureConfig:
    return CaptureConfig(small_objects=SmallObjectsConfig(provider=LearnedConfig(**settings)))


def test_a_program_of_others_finds_it_by_name(tmp_path: Path, room: BoxRoom) -> None:
    color = room.surface.colors[room.instance == len(room.labels) - 1][0]
    detector = CommandedDetector(command=by_color(tmp_path, color), model="painter", draws_masks=True)
    outcome = captured(write_scannet(tmp_path / "scene0001_00", room, labels=room.labels[:-1]), learned(detector=detector))
    found = one_found(outcome, "command:painter")
    assert_is_the_box(outcome, found, "command:painter")
    assert found.category == "book"
    assert found.category_probability == pytest.approx(0.75, abs=0.01)
    assert "1 small object that the scan does not name was found by command:painter" in outcome.degradations


@pytest.mark.parametrize("label", ["wall", "window"])
def test_nobody_finds_a_wall_on_a_table(tmp_path: Path, room: BoxRoom, label: str) -> None:
    color = room.surface.colors[room.instance == len(room.labels) - 1][0]
    detector = CommandedDetector(command=by_color(tmp_path, color, label), model="painter", draws_masks=True)
    outcome = captured(write_scannet(tmp_path / "scene0001_00", room, labels=room.labels[:-1]), learned(detector=detector))
    found = one_found(outcome, "command:painter")
    assert (found.category, found.is_structure) == ("object", False)


def test_the_next_board_is_none_of_what_stands_below_it() -> None:
    """A book that reaches up to a centimeter below a board takes no vertex of it, nor of its own board."""
    grid = np.stack(np.meshgrid(np.arange(-0.3, 0.3, 0.02), np.arange(-0.1, 0.1, 0.02)), -1).reshape(-1, 2)
    boards = np.concatenate([np.column_stack([grid, np.full(len(grid), z)]) for z in (0.5, 0.83)])
    book = np.stack(np.meshgrid(np.arange(0, 0.05, 0.01), np.arange(-0.08, 0.08, 0.01), np.arange(0.5, 0.82, 0.01)), -1).reshape(-1, 3)
    world = Surface(np.concatenate([boards, book[::3]]), np.zeros((0, 3), np.int64), np.zeros((len(boards) + len(book[::3]), 3), np.uint8))
    group = Group("7", "bookshelf", np.arange(len(world.vertices)), np.zeros(0, np.int64))
    slab = SupportSlab(translation([0.0, 0.0, 0.5]), np.array([-0.35, -0.15, -0.03]), np.array([0.35, 0.15, 0.305]), np.array([0.3, 0.1]))
    found = NewInstance("0001", "book", 0.9, "classical", "0000", book, np.zeros((len(book), 3), np.uint8), {})
    making = Making([group], [label_map(None)["bookshelf"]], [scanned_solid(world, group)], world, [book], 0.02)
    number = making.add(0, found, (slab,), label_map(None))
    own = making.groups[number].vertices
    assert own.min() >= len(boards), "a board's"
    assert len(own) > 0.9 * (book[::3][:, 2] > 0.52).sum()


@pytest.mark.whole
def test_networks_and_an_endpoint_make_the_same_rows_of_a_scan_every_time(
    tmp_path: Path, room: BoxRoom, networks: Path, server: Server
) -> None:
    server.answers = [
        says(json.dumps({"items": [{"item": "Book", "color": "red", "count": 1}, {"item": "mug", "color": None, "count": 2}]}))
    ]
    config = learned(
        detector=GroundingDino(weights=str(networks / "grounding_dino"), threshold=0.2, text_threshold=0.0, shortest_px=64, longest_px=96),
        segmenter=Sam2(weights=str(networks / "sam2")),
        items=AskedItems(url=server.url, model="seer-1", pause_seconds=0.0, attempts=1), least_fit=0.0, inside_share=0.0, board_share=1.0,
        consensus=ConsensusConfig(least_masks=1, kept_share=0.0, agreement=0.5),
    )  # fmt: skip
    folder = write_scannet(tmp_path / "scene0001_00", room, labels=room.labels[:-1])
    ledger = Recollection()
    first = captured(folder, config, ledger)
    asked = len(server.requests)
    assert asked == len(ledger.calls) > 0
    assert {row.found_by for row in first.rows["instances"]} == {"file", "grounding_dino+sam2"}
    assert "grounding_dino+sam2" in {mask.found_by for mask in first.rows["masks"]}
    server.answers = [refuses(500)]
    again = captured(folder, config, ledger)
    assert len(server.requests) == asked, "what the ledger has is not asked again"
    assert again.rows == first.rows
    assert again.blobs == first.blobs
    nobody = captured(folder, config)
    assert any("table: items: " in line for line in nobody.degradations), "the scene goes on without them, and says so"
