"""What pages send: JSON objects of a limited size with known fields; and how they are refused, in one line."""

from __future__ import annotations

import asyncio
import contextlib
import re
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from fastapi import Request

from flows.view.annotating.drafts import Key
from flows.view.annotating.work import ServedBatch
from schemas.errors import InputError, LakeError
from schemas.text import one_line
from tasks.annotation.batch import AnnotationBatch, read_answers
from tasks.batches import parse_json

MOST_BYTES = 64 * 1024
"""Of a body: an answer that ranks all candidates takes one."""

MOST_SECONDS = 20.0
"""That sending a body may take: who sends no more must not keep the server from ending."""

MOST_EDITS = 2**53
"""Numbers up to here a page can count."""

TOOL = "metascenes"

ANSWERED = ("choice", "transform", "ranking", "seconds")
"""Fields of `batch.schema.json` that a person sets."""

COUNTED = ("edit", "page")
"""Which edit of which open page a body is of."""

_INNER = re.compile(r"^(annotations|verdicts)\[0\]\.?")


class Refusal(Exception):
    """A request that is refused: status of HTTP, one line that says why, and further fields of the answer."""

    def __init__(self, status: int, reason: str, **fields: Any) -> None:
        super().__init__(reason)
        self.status, self.document = status, {"error": one_line(reason)} | fields


async def json_body(request: Request) -> dict[str, Any]:
    """The JSON object that a request brings.

    Raises:
        Refusal: it is too large, no JSON, or no object.
    """
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        raise Refusal(400, "content-type: must be application/json")
    raw = bytearray()
    try:
        async with asyncio.timeout(MOST_SECONDS):
            async for part in request.stream():
                raw += part
                if len(raw) > MOST_BYTES:
                    raise Refusal(413, f"body: has more than {MOST_BYTES // 1024} KiB")
    except TimeoutError:
        raise Refusal(408, f"body: was not sent within {MOST_SECONDS:g} seconds") from None
    with refusing():
        document = parse_json(bytes(raw), "body")
    if not isinstance(document, dict):
        raise Refusal(400, "body: must be an object")
    return document


def check_fields(body: Mapping[str, Any], allowed: Collection[str]) -> None:
    """Refuse fields that are not known.

    Raises:
        Refusal: names the first.
    """
    unknown = next((name for name in body if name not in allowed), None)
    if unknown is not None:
        raise Refusal(400, f"{unknown[:60]}: is no field of this request; allowed are {', '.join(allowed) or 'none'}")


def edit_of(body: Mapping[str, Any], is_needed: bool = False) -> tuple[int, str]:
    """Which edit of which open page a body is of.

    Raises:
        Refusal: the two cannot be used.
    """
    edit, page = body.get("edit", None if is_needed else 0), body.get("page", "")
    if not isinstance(edit, int) or isinstance(edit, bool) or not 0 <= edit <= MOST_EDITS:
        raise Refusal(400, "edit: must be a whole number from 0 on, the page's count of edits of the object")
    if not isinstance(page, str) or not re.fullmatch(r"[A-Za-z0-9_-]{0,64}", page):
        raise Refusal(400, "page: must be up to 64 letters, digits, '-', '_'")
    return edit, page


def answer_document(work: ServedBatch, name: str, key: Key, values: Mapping[str, Any], moment: str) -> dict[str, Any]:
    """An answer after `batch.schema.json`: what the page sets, of whom and for what as the server knows it."""
    given = {field: value for field, value in values.items() if field not in COUNTED}
    who = {"scene_id": key[0], "instance_id": key[1], "annotator": name, "answered_at": moment}
    return {"batch_id": work.batch_id, "tool": TOOL, "annotations": [given | who]}


def read_draft(work: ServedBatch, name: str, key: Key, body: Mapping[str, Any], moment: str) -> AnnotationBatch:
    """What an annotator sets for an object, held against the schema of answers.

    Raises:
        Refusal: a field is unknown or cannot be used.
    """
    check_fields(body, (*ANSWERED, *COUNTED))
    edit_of(body)
    with refusing():
        return read_answers(answer_document(work, name, key, body, moment), "answer")


def own_key(work: ServedBatch, name: str, key: Key) -> Key:
    """The key of an object that is asked of an annotator.

    Raises:
        Refusal: it is not in the batch, or was erased since, or is asked of others.
    """
    if key not in work.assigned:
        raise Refusal(404, "there is no such object in this batch")
    if name not in work.assigned[key]:
        raise Refusal(403, "this object was given to other annotators")
    with refusing():
        is_asked = work.is_asked(key)
    if not is_asked:
        raise Refusal(404, "this object is in the lake no more")
    return key


@contextlib.contextmanager
def refusing(status: int = 400, by_field: Mapping[str, int] | None = None) -> Iterator[None]:
    """Errors of the lake as refusals with a status of HTTP, `by_field` where it names the field that the error does."""
    try:
        yield
    except InputError as error:
        field = _INNER.sub("", error.field)
        text = ": ".join(part for part in (field, error.problem) if part)
        answered = (by_field or {}).get(field.rpartition(".")[2], status)
        if answered == 409:  # remedies are those of the command line
            raise Refusal(answered, error.problem) from error
        raise Refusal(answered, f"{text}; {error.remedy}" if error.remedy else text) from error
    except LakeError as error:
        raise Refusal(503, str(error)) from error
