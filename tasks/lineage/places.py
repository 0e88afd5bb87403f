"""What an exported scene says of the objects in it: under which name, from which instance and asset."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

from schemas.errors import InputError
from schemas.lineage import Place
from tasks.exports.format import ExportFormat
from tasks.exports.formats import FORMATS
from tasks.families import member, part


def places(format: str, path: str, data: bytes) -> list[Place]:
    """Objects of a format's scene file (`scene.usda`, `scene.xml`, `poses.json`, `*.scene_instance.json`, `*.glb`), in its order.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        return [_place(name, facts) for name, facts in places_of(member(FORMATS, format)).places(data)]
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, struct.error, ElementTree.ParseError) as error:
        raise InputError(path, format, f"cannot be read ({' '.join(str(error).split())})", "export the scene again") from error


def places_of(format: ExportFormat) -> ModuleType:
    """The module of a format's package that reads what exported scenes say: `places(data)` gives names and facts of objects.

    Where names of objects are paths, `has_part(path, name)` says whether a file has what a name below an object's stands for, and
    where scenes state a release, `stated_release(data)` says which. Both may load what has no bounds.

    Raises:
        LookupError: the format has no such module.
    """
    module = part("tasks.exports", format.name, "places")
    if module is None:
        raise LookupError(f"the export format {format.name} has no module places")
    return module


def _place(name: str, facts: Mapping[str, Any]) -> Place:
    return Place(name, facts.get("scene_id"), str(facts["instance_id"]), facts.get("asset_id"))
