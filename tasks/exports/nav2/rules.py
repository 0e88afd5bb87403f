"""Whether a map says what nav2's map_server should read, and, where `objects.json` lies beside it, what that says of the room.

Works on anybody's map. The files are read as map_server reads them; whoever wrote them is not asked.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import is_irregular, is_there, read_file
from schemas.parsing import json_value
from tasks.exports.findings import Finding
from tasks.exports.nav2.grid import FREE, OCCUPIED, UNKNOWN, Raster
from tasks.exports.nav2.map_files import GRAYS, MapSettings, image_path, raster_of, read_cells, read_settings
from tasks.exports.nav2.places import OBJECTS

if TYPE_CHECKING:
    import shapely

RULES: dict[str, str] = {
    "yaml": "the YAML file has every key that map_server asks for, with values that it takes",
    "closed_paths": "the image is named by a relative path inside the folder, and is there",
    "image": "the image can be read, and has no more pixels than a budget allows",
    "resolution": "the resolution is above zero, and the map no larger than a town",
    "thresholds": "thresholds lie between 0 and 1, that of free cells below that of occupied ones",
    "unknown": "the gray that savers of maps write for unknown cells reads as unknown",
    "free": "some of the map is free",
    "objects_file": "objects.json says what the room's floor, its objects and the starts of episodes are",
    "upright": "the map of a room is not turned: its rows run along +X of the world",
    "floor": "no cell of the room's floor is unknown or beside the map",
    "outside": "no cell beyond the room and its doorways is free",
    "footprints": "every cell that an object reaches into between the map's heights is occupied",
    "starts": "episodes start in free cells, or over what agents climb, or under what they pass",
}
"""Every rule, and what holds when it passes."""

_TOWN_M = 10_000.0
_INSET_M = 1e-4  # what reaches into a cell by less lies on its border: corners in the file are rounded to a micrometre
_MOST_PARTS = 100_000  # corners that an objects.json may have in all


def check_nav2(path: Path) -> list[Finding]:
    """Everything that is wrong with a map's YAML file, its image and the `objects.json` beside it, sorted."""
    findings: list[Finding] = []
    try:
        settings = read_settings(path)
    except InputError as error:
        return [Finding("yaml", path.name, str(error))]
    findings += _settings(path, settings)
    try:
        image = image_path(path, settings.image)
    except InputError as error:
        return sorted({*findings, Finding("closed_paths", path.name, str(error))})
    try:
        cells = read_cells(image, settings)
    except InputError as error:
        return sorted({*findings, Finding("image", path.name, str(error))})
    size_m = settings.resolution_m * max(cells.shape)
    if settings.resolution_m > 0.0 and not size_m < _TOWN_M:
        findings.append(Finding("resolution", path.name, f"the map is {size_m / 1000:.3g} km long"))
    if not (cells == FREE).any():
        findings.append(Finding("free", image.name, "has no free cell: no robot has a place on it"))
    objects = path.with_name(OBJECTS)
    if (is_there(objects) or is_irregular(objects)) and not findings:
        findings += _scene(path, objects, settings, cells)
    return sorted(set(findings))


def _settings(path: Path, settings: MapSettings) -> Iterator[Finding]:
    """What the YAML file says."""
    low, high = settings.free_threshold, settings.occupied_threshold
    if not 0.0 < settings.resolution_m < _TOWN_M:
        yield Finding("resolution", path.name, f"resolution is {settings.resolution_m:g}")
    if not max(abs(settings.origin[0]), abs(settings.origin[1])) < _TOWN_M:
        yield Finding("resolution", path.name, f"origin is {settings.origin}, farther away than {_TOWN_M / 1000:g} km")
    if not 0.0 <= low < high <= 1.0:
        yield Finding("thresholds", path.name, f"free_thresh is {low:g}, occupied_thresh {high:g}")
    occupied = 1.0 - GRAYS[UNKNOWN] / 255.0
    if settings.mode == "trinary" and not settings.negate and occupied < low:
        message = f"free_thresh is {low:g}: the gray {GRAYS[UNKNOWN]} of unknown cells, an occupancy of {occupied:.4f}, reads as free"
        yield Finding("unknown", path.name, message, is_there(path.with_name(OBJECTS)))


def _scene(path: Path, objects: Path, settings: MapSettings, cells: NDArray[np.int8]) -> Iterator[Finding]:
    """The map of a room, held against what lies beside it."""
    try:
        document = json_value(read_file(objects, OBJECTS, BUDGET.json_bytes))
        if not isinstance(document, dict) or not str(document.get("frame", "")).startswith("map: "):
            return  # somebody else's
        room = _Room(document)
    except InputError as error:
        yield Finding("objects_file", OBJECTS, str(error))
        return
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError) as error:
        yield Finding("objects_file", OBJECTS, f"cannot be read ({type(error).__name__}: {' '.join(str(error).split())[:100]})")
        return
    if settings.origin[2] != 0.0:
        yield Finding("upright", path.name, f"yaw of the origin is {settings.origin[2]:g}")
        return
    raster = raster_of(settings, cells)
    yield from _floor(path, room, raster, cells)
    for name, outline in room.outlines:
        missed = _reached(raster, outline) & (cells != OCCUPIED)
        if missed.any():
            yield Finding(
                "footprints", f"{OBJECTS} {name}", f"reaches into {missed.sum()} cells that are not occupied, {_first(raster, missed)}"
            )
    yield from _starts(room, raster, cells)


class _Room:
    """What `objects.json` says: the floor, the outlines of objects by name, where agents climb, and starts (id, radius, x, y).

    Raises:
        InputError, ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError: it says something else.
    """

    def __init__(self, document: Any) -> None:
        self.reach_m = float(document["slab_reach_m"])
        self._corners = 0
        self.floor = self._shape(document["floor_m"])
        if self.floor.is_empty:
            raise InputError(OBJECTS, "floor_m", "has no polygon")
        objects = [(str(item["name"]), item) for item in document["objects"]]
        self.outlines = [(name, self._shape(item["outline_m"])) for name, item in objects]
        self.driven_over = [self._shape(item["driven_over_m"]) for _, item in objects]
        self.starts = [(str(item["episode_id"]), float(item["radius_m"]), *self._place(item["position_m"])) for item in document["starts"]]
        for name, item in objects:
            box = np.asarray(item["box_m"], dtype=np.float64)
            if box.shape != (2, 3) or not np.isfinite(box).all() or (box[0] > box[1]).any():
                raise InputError(OBJECTS, f"{name} box_m", "is not a lowest and a highest corner")
        if not 0.0 <= self.reach_m < _TOWN_M or not all(np.isfinite(start[1]) for start in self.starts):
            raise InputError(OBJECTS, "slab_reach_m", "is no distance")

    def _place(self, value: Any) -> tuple[float, float]:
        x, y = (float(number) for number in value)
        if not max(abs(x), abs(y)) < _TOWN_M:
            raise InputError(OBJECTS, "position_m", f"{[x, y]} is no place on a map")
        return x, y

    def _shape(self, polygons: Any) -> shapely.Geometry:
        """Polygons, each an outer ring and holes."""
        import shapely

        made = []
        for rings in polygons:
            places = [[self._place(corner) for corner in ring] for ring in rings]
            self._corners += sum(len(ring) for ring in places)
            if self._corners > _MOST_PARTS:
                raise InputError(OBJECTS, "outline_m", f"has more than {_MOST_PARTS} corners")
            made.append(shapely.Polygon(places[0], places[1:]))
        return shapely.union_all(shapely.make_valid(np.array(made, dtype=np.object_))) if made else shapely.Polygon()


def _floor(path: Path, room: _Room, raster: Raster, cells: NDArray[np.int8]) -> Iterator[Finding]:
    """The floor and what is beyond it."""
    import shapely

    if not shapely.covers(shapely.box(*raster.bounds).buffer(_INSET_M), room.floor):
        yield Finding("floor", path.name, "the room's floor reaches beyond the map")
    unknown = _reached(raster, room.floor) & (cells != FREE) & (cells != OCCUPIED)
    if unknown.any():
        yield Finding("floor", path.name, f"{unknown.sum()} cells of the room's floor are unknown, {_first(raster, unknown)}")
    room_for_robots = _reached(raster, room.floor.buffer(room.reach_m + _INSET_M))
    beyond = (cells == FREE) & ~room_for_robots
    if beyond.any():
        yield Finding("outside", path.name, f"{beyond.sum()} cells beyond the room are free, {_first(raster, beyond)}")


def _starts(room: _Room, raster: Raster, cells: NDArray[np.int8]) -> Iterator[Finding]:
    """Starts of episodes."""
    climbed = np.zeros(cells.shape, dtype=np.bool_)
    for shape in room.driven_over:
        climbed |= _reached(raster, shape)
    for episode, radius, x, y in room.starts:
        column, row = (int(np.floor((value - low) / raster.resolution_m)) for value, low in zip((x, y), raster.origin, strict=True))
        where = f"{OBJECTS} episode {episode}"
        if not (0 <= row < raster.rows and 0 <= column < raster.columns):
            yield Finding("starts", where, f"starts at ({x:g}, {y:g}), beside the map")
        elif cells[row, column] != FREE and not climbed[row, column]:
            # an agent that is thinner than a cell is wide may stand beside what makes the whole cell occupied
            is_certain = bool(radius >= np.sqrt(2.0) * raster.resolution_m or cells[row, column] != OCCUPIED)
            yield Finding("starts", where, f"starts at ({x:g}, {y:g}), in a cell that is {_name(cells[row, column])}", is_certain)


def _reached(raster: Raster, shape: shapely.Geometry) -> NDArray[np.bool_]:
    """Cells that a shape reaches into, shape (rows, columns)."""
    import shapely

    cells = np.zeros((raster.rows, raster.columns), dtype=np.bool_)
    shapely.prepare(shape)
    for places, squares in raster.squares(shape, min(_INSET_M, 0.1 * raster.resolution_m)):
        rows, columns = places[shapely.intersects(shape, squares)].T
        cells[rows, columns] = True
    return cells


def _first(raster: Raster, cells: NDArray[np.bool_]) -> str:
    """Where the first of some cells is."""
    row, column = np.argwhere(cells)[0]
    x, y = (low + (index + 0.5) * raster.resolution_m for low, index in zip(raster.origin, (column, row), strict=True))
    return f"one at ({x:.3f}, {y:.3f})"


def _name(value: int) -> str:
    return {FREE: "free", OCCUPIED: "occupied", UNKNOWN: "unknown"}.get(int(value), f"{value} % occupied")
