"""Rows of calls to models and endpoints: what was asked, what came back, and what that took."""

from __future__ import annotations

from datetime import datetime

from schemas.record import INSTANCE_PATTERN, column, record

CALL_PATTERN = r"[0-9a-f]{64}"


@record("model_calls", key=("call_id",), stage="", rule="append", grain="lake")
class ModelCall:
    """A call to a model behind an endpoint, once for the whole lake: who asks the same again is given what was answered then."""

    call_id: str = column("Hash of kind, model, version, prompt and input", pattern=CALL_PATTERN)
    kind: str = column("What was asked for", values=("chat", "asset", "texture"))
    stage: str = column("Stage that asked first", volatile=True)
    scene_id: str = column("Scene that asked first", volatile=True)
    instance_id: str | None = column("Instance that it was asked for first", pattern=INSTANCE_PATTERN, volatile=True)
    model: str = column("Model, as the endpoint calls it")
    model_version: str = column("Version of the model, as the settings state it; '' where they do not")
    prompt: str = column("Name of the prompt")
    prompt_version: str = column("Hash of the prompt's text, its beginning")
    request_blob: str = column("What was sent, JSON, pictures and all", blob=True)
    outcome: str = column("What came of it", values=("answered", "refused", "away"))
    problem: str | None = column("Why there is no reply", volatile=True)
    reply_blob: str | None = column("What came back", blob=True)
    prompt_tokens: int | None = column("Tokens of the request, as the endpoint counts them", minimum=0)
    reply_tokens: int | None = column("Tokens of the reply, as the endpoint counts them", minimum=0)
    cost_usd: float = column("Tokens times the prices of the settings", unit="USD", minimum=0)
    seconds: float = column("Wall time with all tries and pauses", unit="s", minimum=0, volatile=True)
    attempts: int = column("Requests that were sent, with those that failed", minimum=1, volatile=True)
    lost: int = column("Calls that were under way when their process died, before this one", minimum=0, volatile=True)
    asked_at: datetime = column("When it was asked", volatile=True)
    run: str = column("Run that asked", volatile=True)
