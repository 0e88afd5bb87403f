"""What catalogs say of their models: Objaverse's annotations, ABO's listings, and the plain `index.json` of a folder.

By the public descriptions of these formats (the `objaverse` package; the README of the Amazon Berkeley Objects). What comes of all of
them is the same: facts by the name of a file, or of the model in it.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Iterable
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.parsing import json_value, weigh_json
from tasks.captions.physics import known_name
from tasks.library.format import Axis
from tasks.library.licenses import UNKNOWN, License, license_of
from tasks.unpacking import gunzip

LENGTHS = {
    "inches": 0.0254, "inch": 0.0254, "feet": 0.3048, "centimeters": 0.01, "centimetres": 0.01, "cm": 0.01, "millimeters": 0.001,
    "mm": 0.001, "meters": 1.0, "metres": 1.0, "m": 1.0,
}  # fmt: skip
"""Units of stated sizes [m]."""

LONGEST = 200
"""Signs of a text that is kept."""

GZIP = b"\x1f\x8b"
"""What packed files begin with."""

LANGUAGE = "en"
"""Of texts that come in several."""


@dataclasses.dataclass(frozen=True)
class ModelFacts:
    """What a catalog says of a model; what it leaves out is empty. category: In the project's words where they have one, else in the
    catalog's. extents_m: Sides of its box in no order [m]. unit_m: Metres per unit of the file [m]. front: An axis of the file, `+x`."""

    name: str = ""
    category: str = ""
    category_source: str = ""
    license: License = UNKNOWN
    author: str = ""
    source_url: str = ""
    extents_m: tuple[float, float, float] | None = None
    unit_m: float | None = None
    up: Axis | None = None
    front: str = ""


Facts = dict[str, ModelFacts]
"""Facts by model: its file relative to the library, or its identifier, which is its file's stem."""


def objaverse_facts(annotations: bytes, lvis: bytes | None = None, file: str = "annotations.json") -> Facts:
    """Facts of Objaverse's models by uid. annotations: JSON of `{uid: annotation}` or a list of annotations, packed by gzip or not. lvis:
    JSON of `{category: [uid, ...]}`, which people made by hand: it comes before all else that tells a category.

    Raises:
        InputError: it is no such JSON.
    """
    content = _json(annotations, file)
    rows = content.values() if isinstance(content, dict) else content
    if not isinstance(rows, list | type({}.values())):
        raise InputError(file, "content", f"holds a {type(content).__name__}, not annotations by uid", "is it the right file?")
    seen: dict[str, str] = {}
    listed = _json(lvis, "lvis-annotations.json") if lvis is not None else {}
    for word, uids in listed.items() if isinstance(listed, dict) else ():
        for uid in uids if isinstance(uids, list) else ():
            seen.setdefault(str(uid), _words(str(word)))
    facts: Facts = {}
    for row in rows:
        uid = _text(row, "uid")
        if not uid:
            continue
        tags, kinds = ([(word, field) for word in _names(row, field)] for field in ("tags", "categories"))
        category, source = _category([(seen.get(uid, ""), "lvis"), *tags, (_text(row, "name"), "name"), *kinds])
        user = row.get("user") if isinstance(row.get("user"), dict) else {}
        author = _text(user, "displayName") or _text(user, "username")
        url = _text(row, "viewerUrl") or _text(row, "uri")
        facts[uid] = ModelFacts(_text(row, "name"), category, source, license_of(_text(row, "license")), author, url)
    return facts


def abo_facts(listings: Iterable[bytes], table: bytes, license_text: str, file: str = "listings") -> Facts:
    """Facts of ABO's models by 3dmodel_id. listings: Files of a JSON object a line. table: `3dmodels.csv`. All packed by gzip or not.
    license_text: Of the data set, which says it once for all, in its LICENSE file.

    Raises:
        InputError: a file is broken, or the table has no column `3dmodel_id`.
    """
    text = _unpacked(table, "3dmodels.csv").decode("utf-8-sig", "replace")
    try:
        rows = list(csv.DictReader(io.StringIO(text)))
    except csv.Error as error:
        raise InputError("3dmodels.csv", "content", f"is no table ({error})", "is it the right file?") from error
    if rows and "3dmodel_id" not in rows[0]:
        raise InputError("3dmodels.csv", "3dmodel_id", "is no column", "is it the right file?")
    sides = {row["3dmodel_id"]: tuple(_number(row.get(f"extent_{axis}")) for axis in "xyz") for row in rows}
    terms = license_of(license_text)
    facts: Facts = {name: _of_abo({}, extents, terms) for name, extents in sides.items() if name}
    for number, packed in enumerate(listings):
        lines = _unpacked(packed, f"{file}_{number}")
        try:
            weigh_json(lines, a_line=1000)
        except ValueError as error:
            raise InputError(f"{file}_{number}", "content", str(error), "split it") from error
        for line in lines.splitlines():
            listing = _json(line, f"{file}_{number}") if line.strip() else None
            name = _text(listing, "3dmodel_id")
            if name:
                facts[name] = _of_abo(listing, sides.get(name, (0.0, 0.0, 0.0)), terms)
    return facts


def _of_abo(listing: Any, extents: tuple[float, ...], terms: License) -> ModelFacts:
    """Facts of one model: the sides of its table, which are the file's own, are metres; those of its listing are a shop's."""
    stated = _dimensions(listing)
    kind = next(iter(_names(listing, "product_type", "value")), "")
    name = _localized(listing, "item_name")
    category, source = _category([(_words(kind), "product_type"), (name, "name")])
    x, y, z = extents
    known = stated or ((x, y, z) if min(x, y, z) > 0 else None)
    url = f"https://www.amazon.com/dp/{item}" if (item := _text(listing, "item_id")) else ""
    return ModelFacts(name, category, source, terms, _localized(listing, "brand"), url, known)


def plain_facts(content: bytes, file: str = "index.json") -> Facts:
    """Facts of a folder's own index by file: a list of objects with `file`, `category`, `license` or `licence`, `author`, `source`, `repo`,
    and where somebody knows them `name`, `unit_m`, `up` (`y`, `z`), `front` (`+x`) and `extents_m`.

    Raises:
        InputError: it is no list.
    """
    rows = _json(content, file)
    if not isinstance(rows, list):
        raise InputError(file, "content", "is no list", 'write [{"file": "chair.glb", "category": "chair"}]')
    facts: Facts = {}
    for row in rows:
        name = _text(row, "file")
        if not name:
            continue
        sides = row.get("extents_m")
        values = [_number(side) for side in sides] if isinstance(sides, list) and len(sides) == 3 else []
        unit = _number(row.get("unit_m"))
        up = _text(row, "up").lower()
        facts[name] = ModelFacts(
            name=_text(row, "name") or _text(row, "id"),
            category=_text(row, "category"),
            category_source="index" if _text(row, "category") else "",
            license=license_of(_text(row, "license") or _text(row, "licence")),
            author=_text(row, "author"),
            source_url=" ".join(part for part in (_text(row, "repo"), _text(row, "source")) if part),
            extents_m=(values[0], values[1], values[2]) if values and min(values) > 0 else None,
            unit_m=unit or None,
            up="y" if up == "y" else "z" if up == "z" else None,
            front=_text(row, "front").lower(),
        )
    return facts


def _category(words: list[tuple[str, str]]) -> tuple[str, str]:
    """The first of some words that the project knows, and where it stands; else the first of all, in its own words."""
    for word, source in words:
        known = known_name(word.lower()) if word else None
        if known:
            return known, source
    return next(((word.lower(), source) for word, source in words if word), ("", ""))


def _words(text: str) -> str:
    """`DINING_TABLE`, `coffee_table_(furniture)` as words."""
    return " ".join(text.partition("(")[0].replace("_", " ").lower().split())


def _names(row: Any, field: str, key: str = "name") -> list[str]:
    """Names in a list of objects or texts."""
    values = row.get(field) if isinstance(row, dict) else None
    items = values if isinstance(values, list) else []
    return [text for item in items if (text := _text(item, key) if isinstance(item, dict) else _cut(item))]


def _localized(row: Any, field: str) -> str:
    """The first text in `LANGUAGE` of a list of texts by language, else the first."""
    values = row.get(field) if isinstance(row, dict) else None
    items = [item for item in values if isinstance(item, dict)] if isinstance(values, list) else []
    mine = [item for item in items if _text(item, "language_tag").startswith(LANGUAGE)]
    return next((text for item in [*mine, *items] if (text := _text(item, "value"))), "")


def _dimensions(row: Any) -> tuple[float, float, float] | None:
    """Sides that a listing states [m]; None where one is missing."""
    values = row.get("item_dimensions") if isinstance(row, dict) else None
    sides = []
    for name in ("length", "width", "height"):
        side = values.get(name) if isinstance(values, dict) else None
        stated = side.get("normalized_value", side) if isinstance(side, dict) else {}
        sides.append(_number(stated.get("value")) * LENGTHS.get(_text(stated, "unit").lower(), 0.0) if isinstance(stated, dict) else 0.0)
    return (sides[0], sides[1], sides[2]) if min(sides) > 0 else None


def _json(data: bytes, file: str) -> Any:
    try:
        return json_value(_unpacked(data, file))
    except ValueError as error:
        raise InputError(file, "content", f"is no JSON ({error})"[:200], "is it the right file?") from error


def _unpacked(data: bytes, file: str) -> bytes:
    try:
        text = gunzip(data) if data[:2] == GZIP else data
    except Exception as error:  # what is cut or broken, in whatever way
        raise InputError(file, "content", f"cannot be unpacked ({error})"[:200], "copy it again") from error
    if len(text) > BUDGET.unpacked_bytes:
        raise InputError(file, "size", f"is {len(text)} bytes, more than {BUDGET.unpacked_bytes}", "is it the right file?")
    return text


def _text(row: Any, field: str) -> str:
    return _cut(row.get(field)) if isinstance(row, dict) else ""


def _cut(value: Any) -> str:
    """A text in one line that can be kept."""
    text = value.encode("utf-8", "replace").decode() if isinstance(value, str) else ""
    return " ".join(text.split())[:LONGEST]


def _number(value: Any) -> float:
    """A positive number, 0 for what is none."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return 0.0
    return number if math.isfinite(number) and number > 0 else 0.0
