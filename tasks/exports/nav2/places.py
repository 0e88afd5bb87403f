"""What a map says of the objects in it: `objects.json`, beside the map."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from schemas.parsing import json_value

OBJECTS = "objects.json"
"""Name of the file beside a map that says what stands on it."""


def places(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Objects of a map."""
    for instance in json_value(data)["objects"]:
        yield instance["name"], instance
