"""What an exported scene says of the objects in it: texts of a MuJoCo model."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree import ElementTree


def places(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Texts of an MJCF model that are named as the body which they describe."""
    for text in ElementTree.fromstring(data.decode()).iter("text"):
        facts = json.loads(text.attrib["data"]) if text.attrib["data"].startswith("{") else {}
        if "instance_id" in facts:
            yield text.attrib["name"], facts
