"""What an exported scene says of the objects in it: texts of a MuJoCo model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from schemas.parsing import json_value
from tasks.unpacking import plain_xml_root


def places(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Texts of an MJCF model that are named as the body which they describe."""
    for text in plain_xml_root(data).iter("text"):
        facts = json_value(text.attrib["data"]) if text.attrib["data"].startswith("{") else {}
        if "instance_id" in facts:
            yield text.attrib["name"], facts
