"""JSON, XML, gzip and the heads of images, unpacked within the budget: what would take too much is refused before it is taken."""

from __future__ import annotations

import gzip
import io
import json
import warnings
from typing import Any
from xml.etree import ElementTree

from schemas.budget import BUDGET

KTX2 = b"\xabKTX 20\xbb\r\n\x1a\n"
"""The first bytes of a KTX 2 image."""


class TooMuch(ValueError):
    """What is in a file would take more memory than the budget has."""


_COSTS = {b"[": 88, b"{": 240, b",": 32, b":": 60, b'"': 25}
"""Bytes of memory behind every such sign of a JSON text, more rather than less (CPython 3.11 and 3.12)."""


def json_value(data: bytes | str, **hooks: Any) -> Any:
    """The value in a JSON text; `hooks` are those of `json.loads`.

    Raises:
        ValueError: it is no JSON, would take more memory than `BUDGET.memory_bytes`, or is nested deeper than `BUDGET.depth`.
    """
    weigh_json(data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data)
    too_deep = f"is nested deeper than {BUDGET.depth} values"
    try:
        value = json.loads(data, **hooks)
    except RecursionError as error:
        raise ValueError(too_deep) from error
    level, depth = [value], 1
    while level := [inner for node in level if isinstance(node, dict | list) for inner in _within(node)]:
        depth += 1
        if depth > BUDGET.depth:
            raise ValueError(too_deep)
    return value


def weigh_json(text: bytes, a_line: int = 0) -> None:
    """Raise TooMuch when the values in JSON texts, one or many, would take more memory than `BUDGET.memory_bytes`.

    a_line: Bytes of memory behind every line, where lines are values.
    """
    needed = len(text) + sum(text.count(sign) * cost for sign, cost in _COSTS.items()) + text.count(b"\n") * a_line
    if needed > BUDGET.memory_bytes:
        raise TooMuch(f"its values take about {needed >> 20} MB, more than {BUDGET.memory_bytes >> 20}")


def _within(value: Any) -> list[Any]:
    """The lists and objects directly inside a list or an object."""
    return [inner for inner in (value.values() if isinstance(value, dict) else value) if type(inner) in (dict, list)]


def gunzip(data: bytes) -> bytes:
    """What gzip packed.

    Raises:
        ValueError: it is larger than `BUDGET.unpacked_bytes`.
        OSError, EOFError, zlib.error: it is no gzip, or cut.
    """
    with gzip.GzipFile(fileobj=io.BytesIO(data)) as packed:
        text = packed.read(BUDGET.unpacked_bytes + 1)
    if len(text) > BUDGET.unpacked_bytes:
        raise ValueError(f"unpacks to more than {BUDGET.unpacked_bytes >> 20} MB")
    return text


def xml_root(data: bytes) -> ElementTree.Element:
    """The root of an XML text.

    Raises:
        ValueError: it is larger than `BUDGET.xml_bytes`, or has more elements or attributes than `BUDGET.elements`.
        xml.etree.ElementTree.ParseError, LookupError: it is no XML, or in an unknown encoding.
    """
    _weigh_xml(data)
    return ElementTree.fromstring(data)


def plain_xml_root(data: bytes) -> ElementTree.Element:
    """The root of an XML text that declares no document type, and so no entities that grow or lie elsewhere.

    Raises:
        ValueError: as `xml_root`, or it declares one.
        xml.etree.ElementTree.ParseError, LookupError: as `xml_root`.
    """
    _weigh_xml(data)
    return ElementTree.fromstring(data, parser=ElementTree.XMLParser(target=_PlainBuilder()))


class _PlainBuilder(ElementTree.TreeBuilder):
    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Called where a document type begins, before any entity of it is read."""
        raise ValueError("declares a document type")


def _weigh_xml(data: bytes) -> None:
    if len(data) > BUDGET.xml_bytes:
        raise ValueError(f"is {len(data)} bytes, more than {BUDGET.xml_bytes}")
    if data.count(b"<") > 2 * BUDGET.elements or data.count(b"=") > 4 * BUDGET.elements:
        raise ValueError(f"has more than {BUDGET.elements} elements, or more than {4 * BUDGET.elements} attributes")


def image_pixels(data: bytes) -> int | None:
    """Pixels that an image's head declares, None where it has none that can be read."""
    from PIL import Image

    if data[:12] == KTX2:
        width, height = (int.from_bytes(data[start : start + 4], "little") for start in (20, 24))
        return width * max(height, 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow's own, of images that are refused here
            with Image.open(io.BytesIO(data)) as image:
                width, height = image.size
    except Image.DecompressionBombError:
        return 2 * BUDGET.pixels  # at the least
    except Exception:  # the reader raises whatever the bytes lead it to
        return None
    return width * height
