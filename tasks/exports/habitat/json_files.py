"""JSON as the files of a Habitat dataset have it: the same bytes for the same values."""

from __future__ import annotations

import gzip
import json
from typing import Any


def dump_json(value: Any) -> bytes:
    """A value as JSON: indented, ending in a line feed, never NaN."""
    return (json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode()


def dump_json_gz(value: Any) -> bytes:
    """A value as compressed JSON without a time stamp."""
    return gzip.compress(json.dumps(value, separators=(",", ":"), allow_nan=False, ensure_ascii=False).encode(), 9, mtime=0)
