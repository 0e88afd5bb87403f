"""What an exported scene says of the objects in it: objects of a Habitat scene instance."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any


def places(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Objects of a Habitat scene."""
    for obj in json.loads(data)["object_instances"]:
        if "instance_id" in obj.get("user_defined", {}):
            yield obj["template_name"], obj["user_defined"]
