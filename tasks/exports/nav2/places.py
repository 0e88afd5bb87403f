"""What a map says of the objects in it: `objects.json`, beside the map."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

OBJECTS = "objects.json"
"""Name of the file beside a map that says what stands on it."""


def places(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Objects of a map."""
    for instance in json.loads(data)["objects"]:
        yield instance["name"], instance
