"""What watchers of folders of scans remember between two looks: one small file per folder of scans.

It lies in the lake, because the next look may be taken by another worker on another machine, and one whose memory is
always empty would never see that a scan has stopped changing.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from typing import Any

from schemas.parsing import json_value
from warehouse.storage.files import Storage

FOLDER = "looks"


class Looks:
    """The memory of looks at one address of scans. Scenes are remembered by their hashes, not by name."""

    def __init__(self, storage: Storage, scans: str, prepare: Callable[[], None]) -> None:
        self._storage, self._prepare = storage, prepare
        self._path = f"{FOLDER}/{hashlib.sha256(scans.rstrip('/').encode()).hexdigest()[:32]}.json"

    def read(self) -> dict[str, Any]:
        """The memory that the last look wrote; empty when there is none or it cannot be read: then every scan is new."""
        try:
            record = json_value(self._storage.read(self._path))
        except (FileNotFoundError, ValueError):
            return {}
        return record if isinstance(record, dict) else {}

    def write(self, memory: Mapping[str, Any]) -> None:
        """Replace the memory. Of two looks at once the last one is remembered, whole."""
        self._prepare()
        self._storage.write(self._path, json.dumps(memory, sort_keys=True).encode(), lasting=False)
