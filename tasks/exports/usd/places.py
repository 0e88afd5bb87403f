"""What an exported scene says of the objects in it: prims of a USD scene."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

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


def places(data: bytes) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Prims of a USD text layer whose customData holds `metascenes` with an instance.

    Read by its words: OpenUSD takes half a second to load, which is longer than all the rest of a walk.
    """
    path: list[str] = []
    scopes: list[str] = []  # what each open bracket belongs to: "prim", "about" (a prim's metadata), "ours", "" (anything else)
    stated: dict[str, str] = {}
    wants_name, field, starts_ours, in_custom, named = False, "", False, False, False
    for match in _TOKEN.finditer(data.decode()):
        word = match.group().strip()
        if word[0] in "#@":
            continue
        if word[0] in "\"'":
            if wants_name:
                path.append(_unquoted(word))
                wants_name, named, stated = False, True, {}
            elif field and scopes and scopes[-1] == "ours":
                stated[field] = _unquoted(word)
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
                if named and "instance_id" in stated:
                    yield "/" + "/".join(path), stated
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


def stated_release(data: bytes) -> tuple[int, str | None] | None:
    """Snapshot and release that a `scene.usda` says it was exported from; None when it does not."""
    from pxr import Sdf

    layer = Sdf.Layer.CreateAnonymous(".usda")
    try:
        readable = layer.ImportFromString(data.decode())
    except (UnicodeDecodeError, RuntimeError):
        return None
    stated = dict(layer.customLayerData).get("metascenes", {}) if readable else {}
    return (int(stated["snapshot_id"]), stated.get("release")) if "snapshot_id" in stated else None


def has_part(path: Path, name: str) -> bool:
    """Whether a USD file can be read and has a prim. Runs in a process with bounds."""
    from pxr import Tf, Usd

    try:
        stage = Usd.Stage.Open(str(path))  # a prim lives no longer than its stage
        return bool(stage.GetPrimAtPath(name).IsValid())
    except (Tf.ErrorException, UnicodeDecodeError):
        return False
