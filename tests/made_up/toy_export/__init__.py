"""An export format: a list of what is in a scene. Its gate finds fault with everything where TOY_FAULT is set."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from tasks.exports.files import Export, File
from tasks.exports.findings import Finding
from tasks.exports.format import Doctor, ExportedScene, ExportFormat, checked
from tasks.exports.mjcf import described

RULES = ("toy_objects", "toy_fault")


def check(path: Path) -> Sequence[Finding]:
    if not json.loads(path.read_text())["objects"]:
        return [Finding("toy_objects", path.name, "there are none")]
    return [Finding("toy_fault", path.name, os.environ["TOY_FAULT"])] if "TOY_FAULT" in os.environ else []


def make(scene: ExportedScene) -> Export:
    objects = [{"name": body.name, **described(body)} for body in scene.replica.bodies]
    files = [File(f"{scene.replica.stem}.toy", json.dumps({"objects": objects}).encode(), "scene")]
    return checked(files, RULES, lambda root: check(root / files[0].path))


TOY_EXPORT = ExportFormat(
    name="toy_export",
    title="Toy lists",
    make=make,
    rules=lambda: RULES,
    check=check,
    opened=lambda root: sorted(root.glob("*.toy")),
    doctor=Doctor(about="Check anybody's toy list.", example="scene.toy"),
)
