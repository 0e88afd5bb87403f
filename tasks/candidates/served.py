"""A generator behind a server: text or a picture is posted to it, a GLB comes back at once or is asked for until it is done (specs B.2).

The protocol is the one of Hunyuan3D's server, which is simple enough that others are put behind it: `POST /generate` answers with the GLB;
`POST /send` with `{"uid": ...}`, after which `GET /status/<uid>` answers `{"status": ..., "model_base64": ...}`.
"""

from __future__ import annotations

import base64
import binascii
import dataclasses
import json
import re
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.parsing import json_value
from tasks.calls.exchange import EndpointAway, Exchange, NoAnswer, key_in
from tasks.candidates.assets import MadeAsset
from tasks.candidates.generation.generated import GeneratorInput, GeneratorSettings, generated
from tasks.candidates.provider import CandidateProvider
from tasks.containers import GLB_MAGIC
from tasks.settings import Count, NonNegative, Positive

if TYPE_CHECKING:
    from tasks.candidates.request import CandidateRequest

WHERE = "candidates.slots"
"""The settings, as errors name them."""

STATUS_BYTES = 4 * BUDGET.asset_bytes // 3 + 4096
"""Of a status with a model in it, in base64."""


@dataclasses.dataclass(frozen=True)
class Served(GeneratorSettings):
    """What a generator behind a server makes."""

    kind: ClassVar[str] = "served"
    url: str = ""  # of its server
    key_variable: str = ""  # environment variable that holds the key; servers at home need none
    way: Literal["generate", "send"] = "generate"  # one long request, or one that is asked after
    steps: Count = 30  # of inference; what Hunyuan3D-2 takes by default
    octree_resolution: Count = 256  # of the grid that the surface is taken from; as there
    faces: Count = 40_000  # at most; more say nothing that a simulator sees
    texture: bool = True  # an object without one has no color
    attempts: Count = 4  # to reach it, before it counts as away
    pause_seconds: NonNegative = 2.0  # before the second, twice as long before each next one
    timeout_seconds: Positive = 600.0  # a model takes a minute on a large card
    poll_seconds: NonNegative = 2.0  # between two looks at one under way
    version: str = "1"  # goes up when the same answer would make another asset


def _offer(request: CandidateRequest, config: Served) -> MadeAsset:
    """What the server makes for an instance."""
    if not config.url.startswith(("http://", "https://")):
        raise InputError(WHERE, "url", "is no address", "give that of the generator's server")
    more = {"steps": config.steps, "octree_resolution": config.octree_resolution, "faces": config.faces, "texture": config.texture}
    return generated(request, config, config.kind, config.version, lambda asked, begun: fetched(asked, config, begun), **more)


def fetched(
    asked: GeneratorInput, config: Served, begun: Callable[[], None], sleep: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> bytes:  # fmt: skip
    """The GLB that a server makes.

    Raises:
        InputError: it refuses, or says that it failed.
        EndpointAway: it does not answer, or is not done in time.
    """
    exchange = Exchange(
        config.url, config.model or config.kind, key_in(config.key_variable, WHERE), config.timeout_seconds, config.attempts,
        config.pause_seconds, STATUS_BYTES, WHERE, sleep, clock,
    )  # fmt: skip
    body: dict[str, Any] = {
        "seed": asked.seed, "num_inference_steps": config.steps, "octree_resolution": config.octree_resolution,
        "face_count": config.faces, "texture": config.texture, "type": "glb",
    }  # fmt: skip
    body |= {"text": asked.text} if asked.picture is None else {"image": base64.b64encode(asked.picture).decode()}
    data = json.dumps(body).encode()
    if config.way == "generate":
        made = exchange.send("/generate", data, _glb, begun)
        assert made is not None
        return made
    uid = exchange.send("/send", data, _uid, begun)
    give_up = clock() + config.timeout_seconds
    while clock() < give_up:
        status = exchange.send(f"/status/{uid}", None, _status, begun)
        assert status is not None
        if isinstance(status, bytes):
            return status
        sleep(config.poll_seconds)
    raise EndpointAway(f"{config.url}: {config.model or config.kind} is not done after {config.timeout_seconds:g} s")


def _glb(data: bytes) -> bytes:
    if not data.startswith(GLB_MAGIC) or len(data) > BUDGET.asset_bytes:
        raise NoAnswer("no GLB of a size that is read")
    return data


def _uid(data: bytes) -> str:
    table = _table(data)
    uid = table.get("uid")
    if not isinstance(uid, str) or not re.fullmatch(r"[A-Za-z0-9._-]{1,100}", uid):
        raise NoAnswer("no uid of what was begun")
    return uid


def _status(data: bytes) -> bytes | str:
    """The model where it is done, else what its state is called."""
    table = _table(data)
    model, state = table.get("model_base64"), str(table.get("status", ""))[:60]
    if isinstance(model, str):
        try:
            return _glb(base64.b64decode(model, validate=True))
        except binascii.Error:
            raise NoAnswer("a model that is no base64") from None
    if state.lower() in ("error", "failed", "failure"):
        raise InputError(WHERE, "served", f"the generator failed: {str(table.get('message', state))[:200]}", "see its log")
    if not state:
        raise NoAnswer("no status")
    return state


def _table(data: bytes) -> dict[str, Any]:
    try:
        table = json_value(data)
    except (ValueError, RecursionError):
        table = None
    if not isinstance(table, dict):
        raise NoAnswer("no JSON object")
    return table


def _label(config: Served) -> str:
    return f"{config.kind}:{config.model}" if config.model else config.kind


SERVED = CandidateProvider(name="served", config=Served, offer=_offer, label=_label)
