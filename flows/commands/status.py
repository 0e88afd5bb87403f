"""`metascenes status`: what the lake says of its scenes."""

from __future__ import annotations

import json
from collections import defaultdict

import click

from flows.commands.options import existing_lake, json_option, lake_option


@click.command("status", short_help="Say what is done and what failed, from the lake alone.")
@lake_option
@json_option
def command(address: str, as_json: bool) -> None:
    """Say what is done and what failed, per scene and stage, from the lake alone.

    Example: metascenes status --lake ./lake
    """
    from tasks.pipeline import SCENE_STAGES

    names = [stage.name for stage in SCENE_STAGES]
    states: dict[str, dict[str, str]] = defaultdict(dict)
    errors: list[str] = []
    for (scene, stage), state in sorted(existing_lake(address).history().items()):
        last = state.last
        kept = " (older rows kept)" if state.done is not None else ""
        if stage not in names:  # a batch's, which is no scene
            pass
        elif last.outcome != "done":
            states[scene][stage] = last.outcome + kept
        else:
            states[scene][stage] = "done" if state.done is not None else "withdrawn"
        if last.outcome in ("failed", "lost"):
            errors.append(f"{scene}: {stage}: {last.error}")
    if as_json:
        print(json.dumps({"scenes": states, "errors": errors}))
        return
    for scene, stages in states.items():
        done = [name for name in names if stages.get(name) == "done"]
        rest = ", ".join(f"{name} {stages.get(name, 'not done')}" for name in names if name not in done)
        print(f"{scene:<32} {len(done)}/{len(names)} stages done{'; ' + rest if rest else ''}")
    for error in errors:
        print(error)
    if not states:
        print("the lake is empty")
