"""The gate of toy lists. It finds fault with everything where TOY_FAULT is set."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from tasks.exports.findings import Finding

RULES = ("toy_objects", "toy_fault")


def check_toy_export(path: Path) -> Sequence[Finding]:
    if not json.loads(path.read_text())["objects"]:
        return [Finding("toy_objects", path.name, "there are none")]
    return [Finding("toy_fault", path.name, os.environ["TOY_FAULT"])] if "TOY_FAULT" in os.environ else []
