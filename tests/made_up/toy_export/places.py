"""Objects of a toy list."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any


def places(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for one in json.loads(data)["objects"]:
        yield one["name"], one
