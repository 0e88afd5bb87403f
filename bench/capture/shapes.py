"""Shapes of regions that are found in generated rooms, and what they truly are: the table by which capture names regions of real scans.

`python -m bench.capture.shapes` makes it again, after a change of the segmentation: ten minutes on an idle core.
"""

from __future__ import annotations

import csv
import io
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.dwellings import make_scan
from schemas.files import write_whole
from tasks.capture.files.ply import read_ply
from tasks.capture.instances.naming import FEATURES, SHAPES_FILE, UNKNOWN, ShapeName, ShapeNamingConfig, named_among
from tasks.capture.instances.segmentation import SegmentationConfig, found_shapes
from tasks.furniture import canonical_category
from tasks.furniture.dwellings import dwelling
from tasks.geometry.meshes import Surface
from tasks.geometry.transforms import matrix
from tasks.scanner import owners
from tasks.scanner.dwellings import HARD
from tasks.scanner.scenery import STRUCTURE, Scenery, scenery_of

Array = NDArray[np.float64]
Row = tuple[str, Array]

ROOMS = ((701, 1), (701, 3), (701, 5), (701, 7), (702, 0), (702, 1), (702, 2), (702, 3))
"""Seeds and numbers of hard rooms; benchmarks report others."""

HALF = 0.5
"""A region is of an object's category where so much of it is the object's, and so much of the object is in it."""


def shapes_in(world: Surface, scenery: Scenery) -> list[Row]:
    """Category, or `unknown`, and shape of each region that is found in a mesh of a scenery, world frame [m]."""
    shaped = found_shapes(world, SegmentationConfig())
    owner = owners(scenery, np.concatenate([points for points, _ in shaped]), HARD.owner_reach_m)
    ends = np.cumsum([len(points) for points, _ in shaped])
    rows = []
    for own, (_, shape) in zip(np.split(owner, ends[:-1]), shaped, strict=True):
        objects, counts = np.unique(own, return_counts=True)
        most = int(objects[counts.argmax()])
        is_one = most >= 0 and counts.max() >= HALF * len(own) and counts.max() >= HALF * (owner == most).sum()
        category = scenery.objects[most].category if is_one else UNKNOWN
        rows.append((UNKNOWN if category in STRUCTURE else canonical_category(category) or category, shape))
    return rows


def room_shapes(seed: int, number: int, folder: Path) -> list[Row]:
    """Shapes in a hard room, which is scanned into a folder."""
    truth = make_scan(folder, number, seed)
    surface = read_ply(folder / truth.scan / f"{truth.scan}_vh_clean_2.ply", truth.scan).surface.transformed(matrix(truth.alignment))
    return shapes_in(surface, scenery_of(dwelling((seed, number)).furnished))


def table_of(rows: Iterable[Row]) -> bytes:
    """The table as it ships."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["category", *FEATURES])
    writer.writerows([name, *(f"{value:.3f}" for value in shape)] for name, shape in rows)
    return text.getvalue().encode()


def held_out(rooms: Sequence[Sequence[Row]], config: ShapeNamingConfig) -> list[tuple[str, ShapeName]]:
    """What each region truly is, and what it is called by the shapes of all other rooms."""
    answers = []
    for place, room in enumerate(rooms):
        rest = [row for k, other in enumerate(rooms) if k != place for row in other]
        names = sorted({UNKNOWN, *(name for name, _ in rest)})
        whose, shapes = np.array([names.index(name) for name, _ in rest]), np.array([shape for _, shape in rest])
        answers += [(name, named_among(shape, names, whose, shapes, config)) for name, shape in room]
    return answers


def main() -> None:
    """Make the table again, and say how often its names are right in rooms that are held out."""
    with tempfile.TemporaryDirectory(prefix="shapes-") as folder:
        rooms = [room_shapes(seed, number, Path(folder, str(seed))) for seed, number in ROOMS]
    write_whole(SHAPES_FILE, table_of(row for room in rooms for row in room))
    print_answers(held_out(rooms, ShapeNamingConfig()))


def print_answers(answers: Sequence[tuple[str, ShapeName]]) -> None:
    """A line for names by their probability, and one for those that are called unknown."""
    named = [(name.probability, name.category == true) for true, name in answers if name.category != UNKNOWN]
    for low, high in ((0.5, 0.6), (0.6, 0.7), (0.7, 0.8), (0.8, 0.9), (0.9, 1.01)):
        right = [is_right for probability, is_right in named if low <= probability < high]
        print(f"probability {low:.1f} to {min(high, 1.0):.1f}: {len(right)} names, {np.mean(right) if right else 0.0:.0%} right")
    objects = [(true, name) for true, name in answers if true != UNKNOWN]
    right_objects = sum(name.category == true for true, name in objects)
    print(f"{len(answers)} regions, {len(objects)} of them objects, {right_objects} named rightly, {len(named)} named")


if __name__ == "__main__":
    main()
