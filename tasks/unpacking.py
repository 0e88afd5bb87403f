"""XML, gzip and the heads of images, unpacked within the budget: what would take too much is refused before it is taken."""

from __future__ import annotations

import gzip
import io
import warnings
from xml.etree import ElementTree

from schemas.budget import BUDGET

KTX2 = b"\xabKTX 20\xbb\r\n\x1a\n"
"""The first bytes of a KTX 2 image."""


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
