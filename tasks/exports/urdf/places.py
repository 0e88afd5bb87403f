"""What an exported scene says of its objects: `poses.json`, beside the URDF files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

POSES = "poses.json"
"""Name of the file beside the URDF files that says where they stand."""


def places(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Objects of a list of URDF models with poses."""
    for instance in json.loads(data)["objects"]:
        yield instance["name"], instance
