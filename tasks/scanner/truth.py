"""What is true of the scan of a dwelling: rooms, openings, objects, and what each annotated instance truly holds."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.parsing import json_value
from tasks.furniture.dwellings import Dwelling
from tasks.geometry.transforms import flat
from tasks.scanner.bleeding import Bleed
from tasks.scanner.defects import Annotated, Blindness
from tasks.scanner.scenery import Scenery

Array = NDArray[np.float64]
Corners = tuple[tuple[float, float, float], ...]


@dataclasses.dataclass(frozen=True)
class TrueRoom:
    """A room. polygon: inner corners of its floor (x, y) [m], counter-clockwise; wall k goes from corner k to the next."""

    kind: str
    polygon: tuple[tuple[float, float], ...]
    height_m: float


@dataclasses.dataclass(frozen=True)
class TruePassage:
    """A door, window or passage. room, wall: in whose wall it is; to: the room behind it, -1 for outside. corners: of the hole on the
    wall's inner face [m]. instance: name of the door or window in it, leaf: corners of that object's face [m]; none in a passage."""

    kind: str
    room: int
    wall: int
    to: int
    corners: Corners
    instance: str | None
    leaf: Corners


@dataclasses.dataclass(frozen=True)
class TrueFeature:
    """A half-height or slanted wall: at which wall of which room, and its corners [m]."""

    kind: str
    room: int
    wall: int
    corners: Corners


@dataclasses.dataclass(frozen=True)
class DwellingObject:
    """An object of a dwelling. pose: object to world, 4x4 row by row [m], origin at the bottom center of its box. carrier: name of the
    object below it, or `floor`, `wall`, `ceiling`. is_free: nothing holds it but gravity. observed: share of its surface that the
    mesh covers to 5 cm. has_lost_legs, has_lost_glass: the sensor got no depth of them."""

    name: str
    category: str
    pose: tuple[float, ...]
    extents: tuple[float, float, float]
    carrier: str
    room: int
    is_free: bool
    observed: float
    has_lost_legs: bool
    has_lost_glass: bool


@dataclasses.dataclass(frozen=True)
class TrueInstance:
    """An instance of the scan's annotation. object_id: its number there; label: as written. objects: names of the objects whose
    vertices it has, with their shares, the largest first; the house's own parts by their names."""

    object_id: int
    label: str
    category: str
    objects: tuple[tuple[str, float], ...]
    segment_count: int
    is_merged: bool
    is_split: bool


@dataclasses.dataclass(frozen=True)
class TrueBleed:
    """A strip of vertices that is annotated as the neighbor of its object. source, into: names of the object and of that neighbor, also of
    the house's own parts. reach_m: distance from the neighbor up to which its label reaches [m]."""

    source: str
    into: str
    reach_m: float
    vertices: int


@dataclasses.dataclass(frozen=True)
class DwellingTruth:
    """All of it. alignment: scan frame to world, 4x4 row by row [m]. unseen: share of the objects' surface without mesh."""

    scan: str
    alignment: tuple[float, ...]
    rooms: tuple[TrueRoom, ...]
    openings: tuple[TruePassage, ...]
    features: tuple[TrueFeature, ...]
    objects: tuple[DwellingObject, ...]
    instances: tuple[TrueInstance, ...]
    unseen: float
    hole_count: int
    frame_count: int
    bleeds: tuple[TrueBleed, ...] = ()

    def to_json(self) -> str:
        """As JSON; `from_json` gives the same back."""
        return json.dumps(dataclasses.asdict(self), indent=1)

    @staticmethod
    def from_json(text: str) -> DwellingTruth:
        """What `to_json` wrote."""
        raw = json_value(text)
        return DwellingTruth(
            scan=raw["scan"],
            alignment=tuple(raw["alignment"]),
            rooms=tuple(TrueRoom(**_tuples(row)) for row in raw["rooms"]),
            openings=tuple(TruePassage(**_tuples(row)) for row in raw["openings"]),
            features=tuple(TrueFeature(**_tuples(row)) for row in raw["features"]),
            objects=tuple(DwellingObject(**_tuples(row)) for row in raw["objects"]),
            instances=tuple(TrueInstance(**_tuples(row)) for row in raw["instances"]),
            unseen=raw["unseen"],
            hole_count=raw["hole_count"],
            frame_count=raw["frame_count"],
            bleeds=tuple(TrueBleed(**_tuples(row)) for row in raw.get("bleeds", ())),
        )


def truth_of(
    scan: str, home: Dwelling, scenery: Scenery, alignment: Array, observed: Array, unseen: float, annotated: list[Annotated],
    blind: Blindness, frames: int, bleeds: Sequence[Bleed] = (),
) -> DwellingTruth:  # fmt: skip
    """The truth about a scan of a dwelling."""
    number = {obj.name: index for index, obj in enumerate(scenery.objects)}
    objects = []
    for obj in home.objects:
        index = number[obj.name]
        objects.append(
            DwellingObject(
                obj.name, obj.category, flat(obj.pose), obj.extents, obj.parent, home.room_of[obj.name], obj.name not in home.fitted,
                round(float(observed[index]), 4), index in blind.lost_legs, index in blind.lost_glass,
            )
        )  # fmt: skip
    instances = []
    for object_id, instance in enumerate(annotated):
        held = tuple((scenery.objects[k].name, share) for k, share in instance.objects)
        category = scenery.objects[instance.objects[0][0]].category if instance.objects else ""
        instances.append(
            TrueInstance(object_id, instance.label, category, held, len(instance.segments), instance.is_merged, instance.is_split)
        )
    return DwellingTruth(
        scan=scan,
        alignment=flat(alignment),
        rooms=tuple(TrueRoom(r.kind, tuple((float(x), float(y)) for x, y in r.polygon), home.plan.height) for r in home.plan.rooms),
        openings=tuple(
            TruePassage(
                o.opening.kind,
                o.opening.room,
                o.opening.wall,
                o.opening.to,
                _corners(o.corners),
                o.instance,
                _corners(o.leaf) if o.leaf is not None else (),
            )
            for o in home.openings
        ),
        features=tuple(TrueFeature(f.kind, room, f.wall, _corners(f.solid.vertices)) for room, f in home.features),
        objects=tuple(objects),
        instances=tuple(instances),
        unseen=round(unseen, 4),
        hole_count=len(blind.radii),
        frame_count=frames,
        bleeds=tuple(
            TrueBleed(scenery.objects[b.source].name, scenery.objects[b.into].name, round(b.reach_m, 4), b.vertices) for b in bleeds
        ),
    )


def _corners(points: Array) -> Corners:
    return tuple((float(x), float(y), float(z)) for x, y, z in points)


def _tuples(row: dict[str, Any]) -> dict[str, Any]:
    return {key: _tuple(value) for key, value in row.items()}


def _tuple(value: Any) -> Any:
    return tuple(_tuple(item) for item in value) if isinstance(value, list) else value
