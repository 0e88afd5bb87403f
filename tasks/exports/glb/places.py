"""What an exported scene says of the objects in it: nodes of a GLB."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Any

from schemas.parsing import json_value


def places(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Nodes of a GLB that say which instance they are."""
    if data[:4] != b"glTF":
        raise ValueError("no GLB")
    (length,) = struct.unpack_from("<I", data, 12)
    for node in json_value(data[20 : 20 + length])["nodes"]:
        if "instance_id" in (node.get("extras") or {}):
            yield node["name"], node["extras"]
