"""The walk from what a model said: the call, the prompt, what it was shown, and what it answered."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from schemas.calls import ModelCall
from schemas.parsing import json_value
from schemas.text import cut
from warehouse.lineage.walk import Walk, picked

MOST_LETTERS = 2000
"""Of a prompt and of a reply that a node shows: those that are asked here have some hundreds; the blobs have all of them."""


def follow_call(walk: Walk, source: str, call_id: str | None, role: str, depth: int) -> None:
    """An edge to a call that something names, and from there to its request and reply; nothing where none is named."""
    if call_id is None:
        return
    rows = walk.reader.rows_by_key(ModelCall, [call_id])
    if not rows:
        walk.line(depth, role, walk.missing(source, "model_call", call_id, role))
        return
    row = rows[0]
    facts = picked(
        row, "model", "model_version", "prompt", "prompt_version", "outcome", "prompt_tokens", "reply_tokens", "cost_usd", "seconds",
        "attempts", "lost", "asked_at", "request_blob", "reply_blob",
    )  # fmt: skip
    request = walk.blobs.get(row.request_blob)
    if request is not None:
        facts["asked"] = cut("\n".join(_texts(json_value(request))), MOST_LETTERS)
    if row.reply_blob is not None and row.reply_blob in walk.blobs:
        facts["answered"] = cut(walk.blobs[row.reply_blob].decode(errors="replace"), MOST_LETTERS)
    node = walk.node("model_call", call_id, facts)
    walk.check_blobs(node, (row.request_blob, row.reply_blob))
    walk.leads(depth, source, node, role)


def _texts(asked: Any) -> Iterator[str]:
    """The texts of a request, message by message; a picture is said to be one."""
    for message in asked.get("messages", ()) if isinstance(asked, dict) else ():
        content = message.get("content")
        for part in [{"type": "text", "text": content}] if isinstance(content, str) else content or ():
            yield str(part.get("text", "")) if part.get("type") == "text" else "[picture]"
