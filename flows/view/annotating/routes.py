"""The addresses of the annotation page, and who may ask what of them."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

from anyio.to_thread import run_sync
from fastapi import APIRouter, Depends, FastAPI, Request, Response
from fastapi.responses import JSONResponse

from flows.inputs.annotation import conclude, draw_sample, save_answers, save_verdicts, submit
from flows.inputs.annotation.acts import rows_of
from flows.view.annotating.people import ANNOTATOR, REVIEWER
from flows.view.annotating.requests import (
    ANSWERED,
    COUNTED,
    Refusal,
    answer_document,
    check_fields,
    edit_of,
    json_body,
    own_key,
    read_draft,
    refusing,
)  # fmt: skip
from flows.view.annotating.settling import Rooms
from flows.view.annotating.turns import Turns
from flows.view.annotating.work import ServedBatch, draft_document
from flows.view.application import application, missing, named, scene_routes, tagged
from schemas.annotation import Annotation
from warehouse.tables.snapshot import Reader

PAGE = "annotate.html"

CHANGED = "the scene's candidates have changed since the server was started; start it again"

Body = dict[str, Any]

json_object: Body = Depends(json_body)


def annotation_application(work: ServedBatch, rooms: Rooms) -> FastAPI:
    """The application of the annotation page. Whoever serves it guards it, and says who asks: `scope["person"]`."""
    own = (file_routes(work), annotator_routes(work), placing_routes(work, rooms), reviewer_routes(work))
    app = application([scene_routes(work.scenes, work.refresh), *own], PAGE)

    @app.exception_handler(Refusal)
    def refused(request: Request, refusal: Refusal) -> Response:
        return JSONResponse(refusal.document, refusal.status)

    return app


def asking(work: ServedBatch, role: str = "") -> Callable[[Request], str]:
    """Who asks; with a `role`, refuses who does not have it."""

    def who(request: Request) -> str:
        name = str(request.scope["person"])
        if role and role not in work.roles[name]:
            raise Refusal(403, f"{name} is no {role} of this batch")
        return name

    return who


def file_routes(work: ServedBatch) -> APIRouter:
    """What the page shows of objects and candidates, named by content; who is there, and how the batch stands."""
    api = APIRouter(dependencies=[Depends(work.refresh)])
    person = Depends(asking(work))

    @api.get("/thumbnails/{name}")
    def thumbnail(request: Request, name: str) -> Response:
        return named(request, name, work.thumbnail)

    @api.get("/points/{name}")
    def points(request: Request, name: str) -> Response:
        return named(request, name, lambda name: work.crop(name, work.points))

    @api.get("/photos/{name}")
    def photo(request: Request, name: str) -> Response:
        return named(request, name, lambda name: work.crop(name, work.photos))

    @api.get("/api/photos/{dataset}/{scan}/{instance}/{frame}")
    def other_photo(request: Request, dataset: str, scan: str, instance: str, frame: str) -> Response:
        try:
            return tagged(request, work.photo((f"{dataset}/{scan}", instance), frame), "image/jpeg")
        except KeyError:
            return missing()

    @api.get("/api/me")
    def me(name: str = person) -> Response:
        return JSONResponse(work.me(name))

    @api.get("/api/progress")
    def progress(name: str = person) -> Response:
        return JSONResponse(work.progress())

    return api


def annotator_routes(work: ServedBatch) -> APIRouter:
    """What an annotator asks and changes: their own objects, drafts and answers."""
    api = APIRouter(dependencies=[Depends(work.refresh)])
    person = Depends(asking(work, ANNOTATOR))

    @api.get("/api/work")
    def objects(name: str = person) -> Response:
        return JSONResponse(work.objects(name))

    @api.put("/api/drafts/{dataset}/{scan}/{instance}")
    def keep(dataset: str, scan: str, instance: str, name: str = person, body: Body = json_object) -> Response:
        key = own_key(work, name, (f"{dataset}/{scan}", instance))
        read_draft(work, name, key, body, _now())
        edit, page = edit_of(body, is_needed=True)
        values = work.by_asset(key, {field: body[field] for field in ANSWERED if field in body})
        is_kept, draft = work.drafts.save(key, name, values, edit, page)
        if not is_kept:
            raise Refusal(409, "edit: a later edit of this page is kept already", draft=draft_document(draft))
        return JSONResponse({"edit": draft.edit, "saved_at": draft.saved_at})

    @api.delete("/api/drafts/{dataset}/{scan}/{instance}")
    def discard(dataset: str, scan: str, instance: str, name: str = person) -> Response:
        work.drafts.remove(own_key(work, name, (f"{dataset}/{scan}", instance)), name)
        return JSONResponse({})

    @api.post("/api/answers/{dataset}/{scan}/{instance}")
    def answer(dataset: str, scan: str, instance: str, name: str = person, body: Body = json_object) -> Response:
        key = own_key(work, name, (f"{dataset}/{scan}", instance))
        check_fields(body, (*ANSWERED, *COUNTED, "withdrawn"))
        edit, page = edit_of(body)

        def check(reader: Reader) -> None:
            if not body.get("withdrawn") and not work.is_as_shown(reader, key):
                raise Refusal(409, CHANGED)

        with refusing(by_field={"batch_id": 409, "withdrawn": 409, "answered_at": 409}):
            save_answers(work.lake, answer_document(work, name, key, body, _after_last(work, name, key)), "answer", check=check)
        work.drafts.remove(key, name, edit, page)
        (row,) = [row for row in work.objects(name)["objects"] if (row["scene_id"], row["instance_id"]) == key]
        revision = max(row.revision for row in _revisions(work, name, key))
        return JSONResponse({"revision": revision, "figures": row["figures"]})

    @api.post("/api/submit")
    def hand_in(name: str = person, body: Body = json_object) -> Response:
        check_fields(body, ("partial",))
        partial = body.get("partial", False)
        if not isinstance(partial, bool):
            raise Refusal(400, "partial: must be true or false")
        with refusing(409):
            submit(work.lake, work.batch_id, name, partial)
        return JSONResponse(work.me(name)["batch"])

    return api


def placing_routes(work: ServedBatch, rooms: Rooms) -> APIRouter:
    """What is computed while an annotator places an asset; a few at a time, so that drafts need not wait for it."""
    api = APIRouter(dependencies=[Depends(work.refresh)])
    person = Depends(asking(work, ANNOTATOR))
    turns = Turns()

    @api.post("/api/figures/{dataset}/{scan}/{instance}")
    async def figures(request: Request, dataset: str, scan: str, instance: str, name: str = person, body: Body = json_object) -> Response:
        key = await run_sync(own_key, work, name, (f"{dataset}/{scan}", instance))
        return JSONResponse(await turns.take(request, ("figures", name, key), rooms.figures, name, key, body))

    @api.post("/api/settle/{dataset}/{scan}/{instance}")
    async def settle(request: Request, dataset: str, scan: str, instance: str, name: str = person, body: Body = json_object) -> Response:
        key = await run_sync(own_key, work, name, (f"{dataset}/{scan}", instance))
        return JSONResponse(await turns.take(request, ("settle", name, key), rooms.settled, name, key, body))

    return api


def reviewer_routes(work: ServedBatch) -> APIRouter:
    """What a reviewer asks and changes: the sample, verdicts on answers of others, what becomes of the batch."""
    api = APIRouter(dependencies=[Depends(work.refresh)])
    person = Depends(asking(work, REVIEWER))

    @api.post("/api/sample")
    def sample(name: str = person, body: Body = json_object) -> Response:
        check_fields(body, ())
        with refusing(409):
            result = draw_sample(work.lake, work.batch_id)
        return JSONResponse({key: result[key] for key in ("round", "answers", "sampled", "why", "state")})

    @api.get("/api/reviews")
    def reviews(name: str = person) -> Response:
        return JSONResponse(work.reviews(name))

    @api.put("/api/verdicts/{dataset}/{scan}/{instance}/{annotator:path}")
    def judge(dataset: str, scan: str, instance: str, annotator: str, name: str = person, body: Body = json_object) -> Response:
        check_fields(body, ("passes", "remark"))
        key = (f"{dataset}/{scan}", instance)
        if annotator not in work.assigned.get(key, ()):
            raise Refusal(404, "there is no such answer in this batch")
        verdict = dict(body) | {"scene_id": key[0], "instance_id": key[1], "annotator": annotator, "reviewed_at": _now()}
        document = {"batch_id": work.batch_id, "reviewer": name, "verdicts": [verdict]}
        with refusing(by_field={"batch_id": 409, "instance_id": 404, "annotator": 403}):
            result = save_verdicts(work.lake, document)
        return JSONResponse({key: result[key] for key in ("judged", "sampled")})

    @api.post("/api/conclude")
    def end(name: str = person, body: Body = json_object) -> Response:
        check_fields(body, ())
        with refusing(409):
            result = conclude(work.lake, work.batch_id)
        return JSONResponse({key: result[key] for key in ("verdict", "passed", "sampled", "pass_low", "pass_high", "state", "counts")})

    return api


def _now() -> str:
    return datetime.now(UTC).isoformat()


def _revisions(work: ServedBatch, name: str, key: tuple[str, str]) -> list[Annotation]:
    """All that an annotator answered for an object."""
    rows = rows_of(work.lake.snapshot(), Annotation, work.batch_id)
    return [row for row in rows if (row.scene_id, row.instance_id, row.annotator) == (*key, name)]


def _after_last(work: ServedBatch, name: str, key: tuple[str, str]) -> str:
    """The present time, or a moment after the answer before, should the clock have been set back."""
    last = max((row.answered_at for row in _revisions(work, name, key)), default=None)
    now = datetime.now(UTC)
    return (now if last is None or last < now else last + timedelta(milliseconds=1)).isoformat()
