"""What an exported world says of the objects in it: texts of its models."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from schemas.parsing import json_value
from tasks.unpacking import plain_xml_root

NAMESPACE = "urn:metascenes"
"""Of elements that SDF does not know, and that its readers pass by."""

ABOUT = "about"
"""Name of the element whose text says in JSON what a world or a model is."""


def places(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Models of a world that say which instance they are."""
    for model in plain_xml_root(data).iter("model"):
        facts = json_value(model.findtext(f"{{{NAMESPACE}}}{ABOUT}") or "{}")
        if "instance_id" in facts:
            yield model.attrib["name"], facts
