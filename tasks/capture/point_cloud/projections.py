"""Units of the coordinate system that a LAS file states, as text (WKT 1 and 2) or as keys of GeoTIFF."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from schemas.errors import InputError

MAX_UNIT_M = 1e4
"""Larger units are slips: the largest one in use is the kilometer."""

EQUAL_SHARE = 1e-5
"""Difference of two units that is none: the two feet differ by 2 millionths, 5 micrometers at a ceiling."""

_WRAPPERS = ("", "COMPD_CS", "COMPOUNDCRS", "BOUNDCRS", "SOURCECRS")
_PLANE = ("PROJCS", "PROJCRS", "PROJECTEDCRS", "DERIVEDPROJCRS", "LOCAL_CS", "ENGCRS", "ENGINEERINGCRS")
_GEOGRAPHIC = ("GEOGCS", "GEOGCRS", "GEOGRAPHICCRS")
_GEODETIC = ("GEODCRS", "GEODETICCRS")
_GEOCENTRIC = ("GEOCCS",)
_VERTICAL = ("VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS")
"""Words of text for systems around others, and for systems of each kind."""

_TOKEN = re.compile(r'"(?:[^"]|"")*"|[A-Za-z_]\w*|[-+]?[0-9.][0-9.eE+-]*|[\[\]()]')

_EPSG_UNITS = {
    9001: ("meter", 1.0), 9002: ("foot", 0.3048), 9003: ("US survey foot", 1200 / 3937), 9005: ("Clarke's foot", 0.3047972654),
    9036: ("kilometer", 1000.0), 1025: ("millimeter", 0.001), 1033: ("centimeter", 0.01),
}  # fmt: skip
"""Name and meters of linear units, by EPSG code."""

_MODEL, _GEOGRAPHIC_SYSTEM, _PROJECTED_SYSTEM, _LINEAR, _LINEAR_SIZE, _HEIGHTS = 1024, 2048, 3072, 3076, 3077, 4099
_USER_DEFINED = 32767
"""Keys of GeoTIFF, and the value of a key whose content other keys state."""

_TEXT_RECORD, _KEYS_RECORD, _DOUBLES_RECORD = 2112, 34735, 34736

_PROJECT = "project the points to meters, to UTM"


@dataclasses.dataclass(frozen=True)
class Units:
    """Meters per unit of x and y, and of z; None if the file does not state it. notes: a line each, without the file's name."""

    plane_m: float | None = None
    height_m: float | None = None
    notes: tuple[str, ...] = ()

    @property
    def height_factor(self) -> float:
        """Factor on z that brings it to the unit of x and y."""
        factor = self.height_m / self.plane_m if self.plane_m and self.height_m else 1.0
        return 1.0 if abs(factor - 1.0) < EQUAL_SHARE else factor


def units_of_las(head: Any, name: str) -> Units:
    """Units that the header of a LAS file states.

    Raises:
        InputError: coordinates are angles, or count from the center of the earth.
    """
    records = [record for record in [*head.vlrs, *(head.evlrs or [])] if "LASF_Projection" in record.user_id]
    doubles = next((record for record in records if record.record_id == _DOUBLES_RECORD), None)
    numbers = [float(getattr(number, "value", number)) for number in getattr(doubles, "doubles", [])]
    by_text = [units_of_text(_text(record), name) for record in records if record.record_id == _TEXT_RECORD]
    keys = [key for record in records if record.record_id == _KEYS_RECORD for key in getattr(record, "geo_keys", [])]
    by_keys = [units_of_keys({key.id: (key.tiff_tag_location, key.value_offset) for key in keys}, numbers, name)] if keys else []
    # The header says which of the two counts.
    stated = [*by_text, *by_keys] if head.global_encoding.wkt else [*by_keys, *by_text]
    return next((units for units in stated if units.plane_m is not None), stated[0] if stated else Units())


def _text(record: Any) -> str:
    text = getattr(record, "string", None)  # raw bytes where the library could not decode it
    return text if isinstance(text, str) else bytes(record.record_data).decode("latin-1")


@dataclasses.dataclass
class _Node:
    """A word of WKT with its own values and parts: `UNIT["metre", 1]`."""

    word: str
    values: list[str] = dataclasses.field(default_factory=list)
    parts: list[_Node] = dataclasses.field(default_factory=list)

    def named(self, words: Iterable[str]) -> list[_Node]:
        return [part for part in self.parts if part.word in words]


def units_of_text(text: str, name: str) -> Units:
    """Units of WKT: those of the plane from its projected or local system alone, those of heights from the vertical one.

    Raises:
        InputError: the system of the plane is geographic or geocentric.
    """
    systems = list(_systems(_parsed(text)))
    plane = next((node for node in systems if node.word in (*_PLANE, *_GEOGRAPHIC, *_GEODETIC, *_GEOCENTRIC)), None)
    vertical = next((node for node in systems if node.word in _VERTICAL), None)
    if plane is None:
        note = "the coordinate system is not understood: its unit is not used"
        return Units(notes=(note,) if text.strip("\0 \n") else ())
    title = repr(plane.values[0][:60]) if plane.values else "its system"
    is_cartesian = any("CARTESIAN" in map(str.upper, part.values) for part in plane.named(("CS",)))
    if plane.word in _GEOCENTRIC or (plane.word in _GEODETIC and is_cartesian):
        raise _geocentric(title, name)
    units = _units_of(plane)
    if plane.word in (*_GEOGRAPHIC, *_GEODETIC) or (units and re.match(r"(?i)deg|rad|grad|gon", units[0][0])):
        raise _geographic(title, name)
    heights = _units_of(vertical) if vertical is not None else units[2:3]
    return _stated(units[0] if units else None, heights[0] if heights else None, f"the coordinate system {title}")


def units_of_keys(keys: Mapping[int, tuple[int, int]], doubles: list[float], name: str) -> Units:
    """Units of keys of GeoTIFF. keys: place and value by id. doubles: values that keys refer to.

    Raises:
        InputError: the system is geographic or geocentric.
    """
    values = {key: value for key, (place, value) in keys.items() if not place}
    model = values.get(_MODEL, 0)
    system = values.get(_GEOGRAPHIC_SYSTEM)
    title = f"EPSG:{system}" if system is not None and system != _USER_DEFINED else "its system"
    if model == 3:
        raise _geocentric(title, name)
    if model == 2 or (model != 1 and system is not None and not keys.keys() & {_PROJECTED_SYSTEM, _LINEAR}):
        raise _geographic(title, name)
    plane = _EPSG_UNITS.get(values.get(_LINEAR, 0))
    place, index = keys.get(_LINEAR_SIZE, (0, 0))
    if values.get(_LINEAR) == _USER_DEFINED and place == _DOUBLES_RECORD and index < len(doubles) and 0.0 < doubles[index] < MAX_UNIT_M:
        plane = (f"{doubles[index]:.9g} m", doubles[index])
    projected = values.get(_PROJECTED_SYSTEM, _USER_DEFINED)
    described = "the coordinate system" if projected == _USER_DEFINED else f"the coordinate system EPSG:{projected}"
    return _stated(plane, _EPSG_UNITS.get(values.get(_HEIGHTS, 0)), described)


def _stated(plane: tuple[str, float] | None, height: tuple[str, float] | None, described: str) -> Units:
    """Units with a note on each that is stated, and on one that is missing."""
    if plane is None:
        more = f" but for heights ({height[0]}), which is not used" if height is not None else ""
        return Units(notes=(f"{described} states no known unit{more}",))
    units = Units(plane[1], height[1] if height is not None else None)
    notes = [f"{described} states the unit {plane[0]}"]
    if height is not None and units.height_factor != 1.0:
        notes.append(f"heights are in another unit, {height[0]}: read as stated")
    return dataclasses.replace(units, notes=tuple(notes))


def _geographic(title: str, name: str) -> InputError:
    return InputError(name, "coordinate system", f"{title} is geographic: x and y are degrees", _PROJECT)


def _geocentric(title: str, name: str) -> InputError:
    return InputError(name, "coordinate system", f"{title} is geocentric: z is not up", _PROJECT)


def _systems(node: _Node) -> Iterator[_Node]:
    """Systems within those that only hold others together."""
    for part in node.parts:
        if part.word in _WRAPPERS:
            yield from _systems(part)
        else:
            yield part


def _units_of(system: _Node) -> list[tuple[str, float]]:
    """Name and size of the units of a system's axes; the one of the whole system stands for all without their own."""
    whole = _sizes(system)
    axes = [_sizes(axis)[:1] or whole[:1] for axis in system.named(("AXIS",))]
    return [units[0] for units in axes if units] or whole[:1]


def _sizes(node: _Node) -> list[tuple[str, float]]:
    sizes = []
    for unit in node.named(("UNIT", "LENGTHUNIT", "ANGLEUNIT")):
        try:
            word, size = unit.values[0], float(unit.values[1])
        except (IndexError, ValueError):
            continue
        if 0.0 < size < MAX_UNIT_M:
            sizes.append((re.sub(r"[^\w' -]", "", word)[:40], size))
    return sizes


MAX_DEPTH = 32
"""Brackets within each other; systems that hold others together need four."""


def _parsed(text: str) -> _Node:
    """WKT as a tree; brackets that are never closed end with the text."""
    root = _Node("")
    stack, word = [root], ""
    for token in _TOKEN.findall(text):
        if token in "[(":
            node = _Node(word.upper())
            stack[-1].parts.append(node)
            stack.append(node)
            word = ""
            if len(stack) > MAX_DEPTH:
                return _Node("")
        elif token in "])":
            stack.pop() if len(stack) > 1 else None
        else:
            word = token
            stack[-1].values.append(token.strip('"'))
    return root
