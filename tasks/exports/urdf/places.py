"""What an exported scene says of its objects: `poses.json`, beside the URDF files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from schemas.parsing import json_value

POSES = "poses.json"
"""Name of the file beside the URDF files that says where they stand."""


def places(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Objects of a list of URDF models with poses."""
    for instance in json_value(data)["objects"]:
        yield instance["name"], instance
