"""What an exported scene says of the things in it: `poses.json`, beside the URDF files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any


def places(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Objects of a list of URDF models with poses."""
    for thing in json.loads(data)["objects"]:
        yield thing["name"], thing
