"""The web application: pages with their files, and what they ask of a snapshot. It only reads."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable

from fastapi import APIRouter, Depends, FastAPI, Request, Response
from fastapi.responses import JSONResponse

from flows.view.bundle import KINDS, client_file
from flows.view.frames import picture
from flows.view.scene import Scenes
from schemas.errors import InputError, LakeError
from schemas.text import one_line

BLOB_KINDS = {"glb": "model/gltf-binary", "json": "application/json", "jpg": "image/jpeg", "png": "image/png"}
FOREVER = "private, max-age=31536000, immutable"
"""What is named by its content never changes."""


def application(routers: Iterable[APIRouter], page: str = "view.html") -> FastAPI:
    """An application with a page, the files of the client, and the routes of some routers. Whoever serves it guards it: `gate.guarded`."""
    app = FastAPI(title="Scene lake", docs_url=None, redoc_url=None, openapi_url=None)

    @app.exception_handler(LakeError)
    def refused(request: Request, error: LakeError) -> Response:
        return JSONResponse({"error": one_line(error)}, 404 if isinstance(error, InputError) else 500)

    @app.exception_handler(Exception)
    def failed(request: Request, error: Exception) -> Response:
        return JSONResponse({"error": f"unexpected {type(error).__name__}"}, 500)

    @app.get("/")
    def index(request: Request) -> Response:
        return tagged(request, client_file(page), KINDS[".html"])

    @app.get("/client/{name}")
    def file(request: Request, name: str) -> Response:
        try:
            return tagged(request, client_file(name), KINDS[f".{name.rpartition('.')[2]}"])
        except KeyError:
            return missing()

    for router in routers:
        app.include_router(router)
    return app


def scene_routes(scenes: Scenes, refresh: Callable[[], None] | None = None) -> APIRouter:
    """What any page of ours may ask of the scenes of a snapshot.

    `refresh` is called before each answer, so that no page shows what was erased meanwhile; by default that of the scenes.
    """
    api = APIRouter(dependencies=[Depends(refresh or scenes.refresh)])

    @api.get("/api/scenes")
    def listed() -> Response:
        return JSONResponse(scenes.listed() | {"first": scenes.first()})

    @api.get("/api/scenes/{dataset}/{scan}")
    def scene(dataset: str, scan: str) -> Response:
        return JSONResponse(scenes.shown(f"{dataset}/{scan}").document)

    @api.get("/api/scenes/{dataset}/{scan}/objects/{instance}")
    def explained(dataset: str, scan: str, instance: str) -> Response:
        return JSONResponse({"text": explanation(scenes, f"{dataset}/{scan}", instance)})

    @api.get("/api/scenes/{dataset}/{scan}/frames/{frame}")
    def masks(dataset: str, scan: str, frame: str) -> Response:
        return JSONResponse(scenes.masks(f"{dataset}/{scan}", frame))

    @api.get("/api/scenes/{dataset}/{scan}/frames/{frame}/picture")
    def photograph(request: Request, dataset: str, scan: str, frame: str) -> Response:
        scene_id = f"{dataset}/{scan}"
        return tagged(request, picture(scenes.scan_path(scene_id), scenes.frame(scene_id, frame)), "image/jpeg")

    @api.get("/blobs/{name}")
    def blob(request: Request, name: str) -> Response:
        return named(request, name, scenes.blob)

    return api


def explanation(scenes: Scenes, scene_id: str, instance_id: str) -> str:
    """What `metascenes explain` says of an object.

    Raises:
        InputError: there is no such object.
    """
    from flows.outputs.explain import explain_objects, settings_of
    from tasks.lineage.outline import outline

    if instance_id not in {row["id"] for row in scenes.shown(scene_id).document["objects"]}:
        raise InputError(scenes.lake.address, f"{scene_id}/{instance_id}", "there is no such object")
    lineage = explain_objects(scenes.lake, scene_id, [instance_id], scenes.reader.snapshot_id)[instance_id]
    return outline(lineage, settings_of)


def named(request: Request, name: str, read: Callable[[str], bytes]) -> Response:
    """An answer that is named by its content: a browser asks for it once."""
    headers = {"ETag": f'"{name}"', "Cache-Control": FOREVER}
    try:
        data = read(name)
    except KeyError:
        return missing()
    if request.headers.get("if-none-match") == headers["ETag"]:  # only now: what was erased is not confirmed
        return Response(status_code=304, headers=headers)
    return Response(data, media_type=BLOB_KINDS.get(name.rpartition(".")[2], "application/octet-stream"), headers=headers)


def tagged(request: Request, data: bytes, kind: str) -> Response:
    """An answer that a browser keeps, and asks each time whether it is still right."""
    headers = {"ETag": f'"{hashlib.sha256(data).hexdigest()}"', "Cache-Control": "private, no-cache"}
    if request.headers.get("if-none-match") == headers["ETag"]:
        return Response(status_code=304, headers=headers)
    return Response(data, media_type=kind, headers=headers)


def missing() -> Response:
    """What is not there."""
    return JSONResponse({"error": "there is no such file here"}, 404)
