"""`metascenes status`: the status of a lake, from the lake alone."""

from __future__ import annotations

import dataclasses
import gc
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flows.commands.options import existing_lake, json_option, lake_option
from schemas.wording import counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from flows.run.configuration import Configuration
    from flows.run.status import SceneStatus, Status
    from schemas.runs import RefusedScan
    from warehouse.lake import Lake

SHOWN = 20
"""Scenes that are listed unless all are wanted."""


@click.command("status", short_help="Say what is done, running, failed and stale, from the lake alone.")
@lake_option
@click.option("--config", "config_file", type=click.Path(path_type=Path, dir_okay=False), help="TOML file that the next run will be given.")
@click.option("--set", "settings", multiple=True, metavar="STAGE.FIELD=VALUE", help="One value that it will be given; may be repeated.")
@click.option("--seed", type=int, help="Run seed that it will be given.")
@click.option("--all", "show_all", is_flag=True, help=f"List all scenes that are not simply done, not the first {SHOWN} only.")
@json_option
def command(address: str, config_file: Path | None, settings: tuple[str, ...], seed: int | None, show_all: bool, as_json: bool) -> None:
    """Say what is done, running, failed and stale, why, and how long it will take, from the lake alone.

    Stale is what the next run would redo: the code, annotations, or, with --config, --set or --seed, what it is told
    have changed. Scans and assets are not looked at: what no run has seen yet, or has changed since, is not counted.

    Without a run at work the time left is that of one worker. With --json: counts (scenes by state), seconds_left,
    running (scene_id, stage, host, since), todo (by scene and stage: action, why), runs (those at work, with left and
    seconds_left), scenes (outcome by scene and stage), same (scenes that were made of one scan, under several names), errors,
    broken_checks, refused (scans that the last run over their folder could not use).

    Example: metascenes status --lake ./lake
    """
    lake = existing_lake(address)
    configuration = None
    if config_file is not None or settings or seed is not None:
        from flows.run.configuration import configure

        configuration = configure(config_file, settings, seed=seed)
    gc.disable()  # of 100,000 small Python objects, none of which is garbage, it would look at all again and again
    try:
        status, scenes, wrong, broken, refused = _asked(lake, configuration, bool(config_file or settings), seed is not None)
    finally:
        gc.enable()
    if as_json:
        print(
            json.dumps(
                {**_json(status), "scenes": scenes, "errors": wrong, "broken_checks": broken, "refused": list(map(_refused_json, refused))}
            )
        )
        return
    _print(status, [*map(_refused_text, refused), *wrong, *broken], len(broken), len(refused), show_all)


def _asked(
    lake: Lake, configuration: Configuration | None, configs: bool, seed: bool
) -> tuple[Status, dict[str, dict[str, str]], list[str], list[str], list[RefusedScan]]:
    """Print the state of the lake and its stages, the errors, failed export checks, and the refused scans."""
    from flows.run.plan import annotation_digests
    from flows.run.report import broken_checks
    from flows.run.status import errors, expected, recorded_states, status_of
    from flows.scans.refusals import refused_scans

    claims, runs = lake.claimed(), lake.live_runs()  # first: what is given back later is in the history
    outline = lake.outline()
    brought = expected(annotation_digests(lake), configuration, configs=configs, seed=seed)
    broken = [line for lines in broken_checks(lake).values() for line in lines]
    status = status_of(outline, claims, runs, brought)
    return status, recorded_states(outline.states), errors(outline.states), broken, refused_scans(lake)


def _refused_json(row: RefusedScan) -> dict[str, Any]:
    times = {"first_seen_at": row.first_seen_at.isoformat(), "last_seen_at": row.last_seen_at.isoformat()}
    return dataclasses.asdict(row) | times


def _refused_text(row: RefusedScan) -> str:
    from flows.scans.refusals import refusal_line

    looks = f", looks like {row.format}" if row.format else ""
    return f"refused since {row.first_seen_at:%Y-%m-%d}: {refusal_line(row)} (in {row.scans}{looks})"


def _json(status: Status) -> dict[str, Any]:
    from flows.run.status import when

    running = [
        {
            "scene_id": scene.scene_id,
            "stage": scene.stage,
            "host": scene.claim.host,
            "since": when(scene.claim.since if scene.since is None else scene.since).isoformat(),
            "claimed": when(scene.claim.since).isoformat(),
        }
        for scene in status.scenes
        if scene.claim is not None and scene.state == "running"
    ]
    todo = {
        scene.scene_id: {item.stage: {"action": item.action, "why": item.why} for item in scene.todo}
        for scene in status.scenes
        if scene.todo
    }
    runs = [
        {**dataclasses.asdict(item.run), "started_at": item.run.started_at.isoformat(), "seconds_left": item.seconds_left}
        for item in status.runs
    ]
    answer = {"counts": status.counts(), "seconds_left": status.seconds_left, "running": running, "todo": todo, "runs": runs}
    return answer | {"same": [list(scenes) for scenes in status.same]}


def _print(status: Status, wrong: Sequence[str], broken: int, refused: int, show_all: bool) -> None:
    if not status.scenes and not status.runs and not refused:
        print("the lake is empty")
        return
    more = f"; {counted(refused, 'scan')} refused" if refused else ""
    print(status_line(status) + (f"; {counted(broken, 'check')} of exports failed" if broken else "") + more)
    now = time.time()
    for item in status.runs:
        run = item.run
        how = f"{counted(run.workers, 'worker')}" + (f" ({run.runner})" if run.runner else "")
        since = _span(now - run.started_at.timestamp())
        print(
            f"run on {run.host} for {since}: {how}, {run.done} of "
            f"{counted(run.scenes, 'scene')} done, {run.failed} failed; {_left(item.seconds_left)}"
        )
    order = ("running", "failed", "stale", "unfinished")
    listed = sorted(
        (scene for scene in status.scenes if scene.state != "done"), key=lambda scene: (order.index(scene.state), scene.scene_id)
    )
    for scene in listed if show_all else listed[:SHOWN]:
        print(f"{scene.scene_id:<32} {scene.state:<10} {_what(scene, now)}")
    if not show_all and len(listed) > SHOWN:
        print(f"and {counted(len(listed) - SHOWN, 'more scene')} (--all lists them)")
    for scenes in status.same if show_all else status.same[:SHOWN]:
        print(f"{', '.join(scenes)}: the same scan under {counted(len(scenes), 'name')}; `metascenes lake erase` removes one")
    if not show_all and len(status.same) > SHOWN:
        print(f"and {counted(len(status.same) - SHOWN, 'more scan')} under several names (--all lists them)")
    for line in wrong if show_all else wrong[:SHOWN]:
        print(line)
    if not show_all and len(wrong) > SHOWN:
        print(f"and {counted(len(wrong) - SHOWN, 'more error')} (--all lists them)")


def status_line(status: Status) -> str:
    """The status in a line."""
    counts = status.counts()
    parts = [f"{counts['done']} done", *(f"{count} {state}" for state, count in counts.items() if count and state != "done")]
    if status.runs:
        return f"{', '.join(parts)}; {_left(status.seconds_left)}"
    if status.seconds_left == 0:
        return ", ".join(parts)
    return f"{', '.join(parts)}; {_left(status.seconds_left)} for one worker"


def _what(scene: SceneStatus, now: float) -> str:
    """What is to be said of a scene: who is at it, or what the next run would do and why."""
    if scene.claim is not None and scene.state == "running":
        since = scene.claim.since if scene.since is None else scene.since
        return f"{scene.stage or 'begun'}, for {_span(now - since)}, on {scene.claim.host}"
    parts = [f"waits for a worker on {scene.claim.host}"] if scene.claim is not None else []
    parts += [f"{item.stage} failed" for item in scene.todo if item.has_failed]
    causes: dict[str, list[str]] = {}
    waiting = following = 0
    for item in scene.todo:
        if item.action == "wait":
            waiting += 1
        elif item.why.endswith("will be redone"):
            following += 1
        elif item.action == "run" or not item.has_failed:
            causes.setdefault(item.why, []).append(item.stage)
    parts += [f"{', '.join(stages)}: {why}" for why, stages in causes.items()]
    for count, what in ((following, "follow"), (waiting, "wait")):
        if count:
            parts.append(counted(count, f"stage {what}s", f"stages {what}"))
    return "; ".join(parts)


def _left(seconds: float | None) -> str:
    return "time left unknown" if seconds is None else f"about {_span(seconds)} left"


def _span(seconds: float) -> str:
    """A span of time in the unit that fits."""
    for unit, size in (("s", 1), ("min", 60), ("h", 3600), ("d", 86_400)):
        if seconds < 99 * size or unit == "d":
            return f"{max(seconds, 0) / size:.0f} {unit}" if seconds >= 9.5 * size or size == 1 else f"{seconds / size:.1f} {unit}"
    raise AssertionError("the last unit takes all")
