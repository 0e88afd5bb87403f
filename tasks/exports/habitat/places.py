"""What an exported scene says of the objects in it: objects of a Habitat scene instance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from schemas.parsing import json_value


def places(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Objects of a Habitat scene."""
    for obj in json_value(data)["object_instances"]:
        if "instance_id" in obj.get("user_defined", {}):
            yield obj["template_name"], obj["user_defined"]
