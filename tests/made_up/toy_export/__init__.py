"""An export format: a list of what is in a scene."""

from __future__ import annotations

import json
from types import ModuleType

from tasks.exports.files import Export, File
from tasks.exports.format import Doctor, ExportedScene, ExportFormat, checked
from tasks.exports.mjcf import described


def gate() -> ModuleType:
    from tasks.exports.toy_export import rules

    return rules


def make(scene: ExportedScene) -> Export:
    objects = [{"name": body.name, **described(body)} for body in scene.replica.bodies]
    files = [File(f"{scene.replica.stem}.toy", json.dumps({"objects": objects}).encode(), "scene")]
    return checked(files, TOY_EXPORT, files[0].path)


TOY_EXPORT = ExportFormat(
    name="toy_export",
    title="Toy lists",
    make=make,
    gate=gate,
    opened=lambda root: sorted(root.glob("*.toy")),
    doctor=Doctor(about="Check anybody's toy list.", example="scene.toy"),
)
