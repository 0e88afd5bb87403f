"""What an exported scene says of the things in it: under which name, from which instance and asset."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree import ElementTree

from schemas.errors import InputError
from schemas.lineage import Place


def places(format: str, path: str, data: bytes) -> list[Place]:
    """Things of a format's scene file (`scene.usda`, `scene.xml`, `poses.json`, `*.scene_instance.json`, `*.glb`), in its order.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        return [_place(name, facts) for name, facts in _READERS[format](data)]
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, struct.error, ElementTree.ParseError) as error:
        raise InputError(path, format, f"cannot be read ({' '.join(str(error).split())})", "export the scene again") from error


def _place(name: str, facts: Mapping[str, Any]) -> Place:
    return Place(name, facts.get("scene_id"), str(facts["instance_id"]), facts.get("asset_id"))


_TOKEN = re.compile(
    r"""
    \"\"\".*?\"\"\" | '''.*?''' | "(?:\\.|[^"\\\n])*" | '(?:\\.|[^'\\\n])*'  # text
    | @[^@\n]*@ | \#[^\n]*  # file, comment
    | [(){}]
    | ^\s*(?:def|over|class)\b
    | \bcustomData\s*= | \bdictionary\s+metascenes\s*= | \bstring\s+\w+\s*=
    """,
    re.VERBOSE | re.MULTILINE | re.DOTALL,
)


def _usd(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Prims of a USD text layer whose customData holds `metascenes` with an instance.

    Read by its words: OpenUSD takes half a second to load, which is longer than all the rest of a walk.
    """
    path: list[str] = []
    scopes: list[str] = []  # what each open bracket belongs to: "prim", "about" (a prim's metadata), "ours", "" (anything else)
    said: dict[str, str] = {}
    wants_name, field, starts_ours, in_custom, named = False, "", False, False, False
    for match in _TOKEN.finditer(data.decode()):
        word = match.group().strip()
        if word[0] in "#@":
            continue
        if word[0] in "\"'":
            if wants_name:
                path.append(_unquoted(word))
                wants_name, named, said = False, True, {}
            elif field and scopes and scopes[-1] == "ours":
                said[field] = _unquoted(word)
            field = ""
        elif word in ("def", "over", "class"):
            wants_name = not scopes or scopes[-1] == "prim"
        elif word.startswith("customData"):
            in_custom = bool(scopes) and scopes[-1] == "about"
        elif word.startswith("dictionary"):
            starts_ours = bool(scopes) and scopes[-1] == "custom"
        elif word.startswith("string"):
            field = word.removeprefix("string").rstrip("=").strip()
        elif word in "({":
            if word == "(":
                scopes.append("about" if named else "")
            elif in_custom:
                scopes.append("custom")
            elif starts_ours:
                scopes.append("ours")
            else:
                scopes.append("prim" if named else "")
                if named and "instance_id" in said:
                    yield "/" + "/".join(path), said
                named = False
            in_custom = starts_ours = False
        elif scopes.pop() == "prim":
            path.pop()


def _unquoted(text: str) -> str:
    """A string of a USD text layer without its quotes and escapes."""
    marks = 3 if text[:3] in ('"""', "'''") else 1
    escapes = {"n": "\n", "t": "\t", "r": "\r"}
    plain = re.compile(r"\\(x[0-9a-fA-F]{2}|.)", re.DOTALL)
    return plain.sub(lambda m: chr(int(m[1][1:], 16)) if len(m[1]) == 3 else escapes.get(m[1], m[1]), text[marks:-marks])


def _mjcf(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Texts of an MJCF model that are named as the body which they describe."""
    for text in ElementTree.fromstring(data.decode()).iter("text"):
        facts = json.loads(text.attrib["data"]) if text.attrib["data"].startswith("{") else {}
        if "instance_id" in facts:
            yield text.attrib["name"], facts


def _urdf(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Objects of a list of URDF models with poses."""
    for thing in json.loads(data)["objects"]:
        yield thing["name"], thing


def _habitat(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Objects of a Habitat scene."""
    for thing in json.loads(data)["object_instances"]:
        if "instance_id" in thing.get("user_defined", {}):
            yield thing["template_name"], thing["user_defined"]


def _glb(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Nodes of a GLB that say which instance they are."""
    if data[:4] != b"glTF":
        raise ValueError("no GLB")
    (length,) = struct.unpack_from("<I", data, 12)
    for node in json.loads(data[20 : 20 + length])["nodes"]:
        if "instance_id" in (node.get("extras") or {}):
            yield node["name"], node["extras"]


_READERS = {"usd": _usd, "mjcf": _mjcf, "urdf": _urdf, "habitat": _habitat, "glb": _glb}
