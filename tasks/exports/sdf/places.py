"""What an exported world says of the objects in it: texts of its models."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree import ElementTree

NAMESPACE = "urn:metascenes"
"""Of elements that SDF does not know, and that its readers pass by."""

ABOUT = "about"
"""Name of the element whose text says in JSON what a world or a model is."""


def places(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Models of a world that say which instance they are."""
    for model in ElementTree.fromstring(data.decode()).iter("model"):
        facts = json.loads(model.findtext(f"{{{NAMESPACE}}}{ABOUT}") or "{}")
        if "instance_id" in facts:
            yield model.attrib["name"], facts
