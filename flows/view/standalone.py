"""One scene as one HTML file that opens without a server: client and data are inside, nothing is asked for."""

from __future__ import annotations

import base64
import gzip
import hashlib
import html
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from flows.view.bundle import client_file
from flows.view.frames import AWAY
from flows.view.scene import Document, Scenes
from schemas.files import write_whole
from warehouse.lake import Lake


def write_page(scenes: Scenes, scene_id: str, out: Path) -> int:
    """Write the page of a scene; its size in bytes. The same snapshot gives the same bytes.

    Raises:
        InputError: there is no such scene, or the client was not built.
    """
    page = "".join(_page(scenes, scene_id)).encode()
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, page)
    return len(page)


def write_page_of(lake: Lake, snapshot_id: int, scene_id: str, out: Path) -> int:
    """Write the page of a scene in a snapshot; its size in bytes. Runs in a worker process."""
    return write_page(Scenes(lake, snapshot_id), scene_id, out)


def _page(scenes: Scenes, scene_id: str) -> Iterator[str]:
    style, script = client_file("view.css").decode(), _inline(client_file("view.js").decode())
    policy = (
        f"default-src 'none'; script-src {_hash(script)}; style-src {_hash(style)}; img-src data: blob:; connect-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )
    yield '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
    yield f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">\n<meta name="color-scheme" content="light dark">\n'
    yield f'<title>{html.escape(scene_id)}</title>\n<link rel="icon" href="data:,">\n<style>{style}</style>\n</head>\n<body>\n'
    yield '<noscript><p class="away">This page draws with JavaScript and WebGL.</p></noscript>\n<div id="page"></div>\n'
    yield from _data(scenes, scene_id)
    yield f"<script>{script}</script>\n</body>\n</html>\n"


def _data(scenes: Scenes, scene_id: str) -> Iterator[str]:
    """What the page would ask a server for, each in an element whose id is what is asked."""
    from flows.outputs.explain import explain_objects, settings_of
    from tasks.lineage.outline import outline

    shown, listing = scenes.shown(scene_id), scenes.listed()
    own = [row for row in listing["scenes"] if row["id"] == scene_id]
    yield _json("api/scenes", {**listing, "lake": "", "scenes": own, "first": scene_id})
    document: Document = {**shown.document, "frames": {"excuse": AWAY, "rows": []}}
    yield _json(f"api/scenes/{scene_id}", document)
    lineages = explain_objects(scenes.lake, scene_id, [row["id"] for row in document["objects"]], scenes.reader.snapshot_id)
    for instance_id, lineage in lineages.items():
        yield _json(f"api/scenes/{scene_id}/objects/{instance_id}", {"text": outline(lineage, settings_of)})
    for name in sorted({*shown.blobs, *shown.made}):
        packed = base64.b64encode(gzip.compress(scenes.blob(name), 6, mtime=0)).decode()
        yield f'<script type="text/plain" id="blobs/{name}">{packed}</script>\n'


def _json(name: str, value: Any) -> str:
    """A value in an element that no browser runs; nothing in it can end the element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return f'<script type="application/json" id="{html.escape(name)}">{text}</script>\n'


def _inline(script: str) -> str:
    """A script as it may stand in a page: what would end its element is written otherwise."""
    return script.replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _hash(text: str) -> str:
    """What a policy calls an inline script or style by."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
