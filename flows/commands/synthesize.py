"""`metascenes synthesize`: scenes that a model draws, put through the stages until simulators load them."""

from __future__ import annotations

import dataclasses
import json
from typing import TYPE_CHECKING, Any

import click

from flows.commands.options import end_with_failures, grouped, json_option, lake_option, workers_option
from schemas.wording import counted

if TYPE_CHECKING:
    from flows.inputs.synthesis import SceneSynthesis, Synthesized

_request_options = grouped(
    click.option("--instance", metavar="SCENE/ID", help="Furnish a large object of a scene in the lake anew, instead of --large."),
    click.option("--size", nargs=3, type=float, metavar="X Y Z", help="Depth, width, height of the large object [m]; else by chance."),
    click.option("--room-type", help="Kind of room: bedroom, office, living room, ...; unknown by default."),
    click.option("--large", metavar="CATEGORY", help="Large object: desk, nightstand, coffee_table, ..."),
)
"""What is to be drawn."""

_run_options = grouped(
    json_option,
    click.option("--dry-run", is_flag=True, help="Say what would be drawn; write nothing."),
    click.option("--retry-failed", is_flag=True, help="Make scenes again that failed before on the same input."),
    workers_option,
    click.option("--license-allow", multiple=True, metavar="LICENSE",
                 help="Take assets of the lake with these licenses only; as `metascenes export` has it."),
    click.option("--assets", type=click.Choice(["lake", "made"]), default="lake", show_default=True,
                 help="Take assets of the lake where they fit, or have all made."),
    click.option("--name", default="", help="Beginning of the scenes' names; by default what was asked for, with a hash of it."),
    click.option("--dataset", default="synthetic", show_default=True, metavar="NAME",
                 help="Dataset of the scenes: <dataset>/<name>_<number>."),
    click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same request and seed give the same scenes."),
    click.option("--count", type=click.IntRange(1), default=1, show_default=True, help="Number of scenes."),
    click.option("--model", default="physcene", show_default=True, metavar="MODEL",
                 help="Newest model of an architecture (atiss, diffuscene, physcene), or a model's id."),
    lake_option,
)  # fmt: skip
"""How."""


@click.command("synthesize", short_help="Draw what stands on a table, and make scenes of it that simulators load.")
@_request_options
@_run_options
def command(
    large: str | None, room_type: str | None, size: tuple[float, float, float] | None, instance: str | None, address: str, model: str,
    count: int, seed: int, dataset: str, name: str, assets: str, license_allow: tuple[str, ...], workers: int, retry_failed: bool,
    dry_run: bool, as_json: bool,
) -> None:  # fmt: skip
    """Draw what stands on a large object, and make scenes of it that simulators load.

    A learned model draws boxes; assets of the lake, or made ones, take their places; then the stages that any scene goes
    through put them to rest, certify that they stay, and export them. The same command again does what is missing, as a rule
    nothing; with a greater --count it adds scenes.

    Example: metascenes synthesize --large desk --room-type office --count 20 --model physcene --lake ./lake
    """
    from flows.inputs.synthesis import SceneRequest, asked, drawing_model, synthesize
    from warehouse.lake import Lake
    from warehouse.release.licenses import Allowed

    if instance and (large or room_type or size):
        raise click.UsageError("--instance brings a large object of its own: leave out --large, --room-type and --size")
    if not (instance or large):
        raise click.UsageError("say what is to be furnished: --large CATEGORY, or --instance SCENE/ID")
    lake = Lake.open(address)
    request = asked(lake, SceneRequest(large or "", room_type or "unknown", size, instance or ""))
    result = synthesize(
        lake, request, drawing_model(lake, model), count=count, seed=seed, dataset=dataset, name=name, use_assets=assets == "lake",
        licenses=Allowed.parse(license_allow) if license_allow else None, workers=workers, dry_run=dry_run, retry_failed=retry_failed,
    )  # fmt: skip
    print(json.dumps(_as_json(result, dry_run)) if as_json else _as_text(result, dry_run))
    end_with_failures({} if as_json else {scene.scene_id: scene.error for scene in result.failed}, bool(result.failed))


def _as_json(result: Synthesized, dry_run: bool) -> dict[str, Any]:
    scenes = [
        {
            **{name: getattr(scene, name) for name in ("scene_id", "number", "action", "why", "error")},
            "made": None if scene.done is None else dataclasses.asdict(scene.done),
        }
        for scene in result.scenes
    ]
    return {
        "model_id": result.model_id, "model_kind": result.model_kind, "seed": result.seed, "dry_run": dry_run, "scenes": scenes,
        "failed": len(result.failed),
    }  # fmt: skip


def _as_text(result: Synthesized, dry_run: bool) -> str:
    """A line for each scene, and what came of all of them."""
    lines = [_line(scene, dry_run) for scene in result.scenes if scene.action != "reuse" or dry_run]
    made = [scene.done for scene in result.scenes if scene.done is not None and scene.error is None]
    todo = sum(scene.action in ("draw", "go on") for scene in result.scenes)
    parts = [f"{counted(todo, 'scene')} would be made" if dry_run else f"{counted(len(made), 'scene')} made"]
    parts += [f"{sum(scene.action == 'reuse' for scene in result.scenes)} unchanged", f"{len(result.failed)} failed"]
    lines.append(f"{', '.join(parts)}; {result.model_kind} {result.model_id[:12]}, seed {result.seed}")
    objects = sum(done.objects for done in made)
    if objects:
        shares = (100 * sum(values) / objects for values in ([done.proposed for done in made], [done.settled for done in made]))
        as_drawn, settled = (f"{share:.0f} %" for share in shares)
        lines.append(f"{counted(objects, 'object')}: {as_drawn} stay within 1 cm where they were drawn, {settled} where they were put")
    return "\n".join(lines)


def _line(scene: SceneSynthesis, dry_run: bool) -> str:
    if scene.done is None or scene.error is not None:
        return f"{scene.scene_id:<48} {scene.action:<7} {scene.why if dry_run or scene.error is None else 'failed'}"
    done = scene.done
    gates = f"{counted(len(done.broken), 'rule')} of gates broken: {', '.join(done.broken[:3])}" if done.broken else "all gates passed"
    count = f"{done.objects} {'object' if done.objects == 1 else 'objects'}"
    return f"{scene.scene_id:<48} {count}, {done.proposed} stable as drawn, {done.settled} settled; {gates}"
