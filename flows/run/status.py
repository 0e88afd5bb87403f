"""The status of a lake, from the lake alone: which scenes are done, running, failed, stale or unfinished, and the time left.

What the next run with the same scans would do is decided as a plan decides it, but for the scans and the library: these
are taken to be what the newest run of each scene saw. Where the run of a stage is no longer in the lake (it was removed
before it was committed, or overtaken), what failed after it is said to run, though a plan may know the failure again. Does
not import Prefect.
"""

from __future__ import annotations

import dataclasses
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Literal, NamedTuple

from flows.run.configuration import Configuration
from flows.run.fingerprints import canonical_json, code_fingerprint, digest
from tasks.pipeline import MODULES, SCENE_STAGES, upstream
from tasks.stage import Stage
from warehouse.sharing.claims import Claim
from warehouse.sharing.presence import LiveRun
from warehouse.tables.history import Key
from warehouse.tables.outline import Execution, Outline, StageOutline

State = Literal["done", "running", "failed", "stale", "unfinished"]
STATES: tuple[State, ...] = ("done", "running", "failed", "stale", "unfinished")

_NEW = ""
"""Fingerprint of what is not computed yet: no recorded one is like it."""

_ABOVE = {stage.name: tuple(other.name for other in upstream(stage) if other.grain == "scene") for stage in SCENE_STAGES}


_ORDER = (*(name for stage in SCENE_STAGES for name in stage.outside), "annotations", *_ABOVE, "config", "code", "seed")
"""Names of the parts of fingerprints in the order in which a plan tells them."""


@dataclasses.dataclass(frozen=True)
class Expected:
    """What the next run would bring along, as parts of fingerprints.

    `code` by stage, `config` by stage where it was told, `seed` if it was, `annotations` by scene; what was not told is
    taken to be what the newest run had.
    """

    code: Mapping[str, str]
    annotations: Mapping[str, str]
    config: Mapping[str, str]
    seed: str | None = None


class Todo(NamedTuple):
    """A stage of a scene that is not simply done.

    `run`: it will be computed. `report`: it failed and will not be computed again. `wait`: it reads from a stage that did
    not succeed. `is_redone`: there are rows, which are outdated. `has_failed`: its newest run has.
    """

    stage: str
    action: Literal["run", "report", "wait"]
    why: str
    is_redone: bool = False
    has_failed: bool = False


@dataclasses.dataclass(frozen=True)
class SceneStatus:
    """A scene: its state, what the next run would do, and who has claimed it.

    `stage`: what a worker is at, if that can be told, `since` when [s since the epoch]. A scene that is claimed and not
    running waits for a worker.
    """

    scene_id: str
    state: State
    todo: tuple[Todo, ...]
    claim: Claim | None = None
    stage: str | None = None
    since: float | None = None


@dataclasses.dataclass(frozen=True)
class RunStatus:
    """A run that is at work, and the time that it still takes [s], None where no stage of it was ever timed."""

    run: LiveRun
    seconds_left: float | None


@dataclasses.dataclass(frozen=True)
class Status:
    """How a lake stands. `seconds_left` [s] is that of the runs at work, without any that of one worker for all that is to do.

    `same`: scenes that were made of one and the same scan under several names, those of a scan together.
    """

    scenes: tuple[SceneStatus, ...]
    runs: tuple[RunStatus, ...]
    seconds_left: float | None
    same: tuple[tuple[str, ...], ...] = ()

    def counts(self) -> dict[State, int]:
        """How many scenes are in each state."""
        counted = Counter(scene.state for scene in self.scenes)
        return {state: counted[state] for state in STATES}


def expected(
    annotations: Mapping[str, str], configuration: Configuration | None = None, *, configs: bool = False, seed: bool = False
) -> Expected:
    """What the next run would bring along, with today's code; of a configuration, its configs or its seed if these are told."""
    stage_configs = configuration.stages if configuration is not None and configs else {}
    return Expected(
        code={stage.name: f"code={code_fingerprint(MODULES[stage.name])}" for stage in SCENE_STAGES},
        annotations=annotations,
        config={
            stage.name: f"config={digest(canonical_json(stage_configs[stage.name]))}"
            for stage in SCENE_STAGES
            if stage.name in stage_configs
        },
        seed=f"seed={configuration.seed}" if configuration is not None and seed else None,
    )


def status_of(
    outline: Outline, claims: Mapping[str, Claim], runs: Sequence[LiveRun], brought: Expected, now: float | None = None
) -> Status:
    """The status of a lake, by the history in outline, the claims of living runs, and these runs."""
    now = time.time() if now is None else now
    medians = {stage: seconds for stage, seconds in outline.median_seconds.items() if stage in _ABOVE}
    by_scene: dict[str, dict[str, StageOutline]] = {scene: {} for scene in claims}
    for (scene, stage), state in outline.states.items():
        if stage in _ABOVE:
            by_scene.setdefault(scene, {})[stage] = state
    works = _at_work(claims, runs, by_scene)
    scenes = tuple(
        _scene_status(scene, past, claims.get(scene), works.get(scene, "waits"), brought) for scene, past in sorted(by_scene.items())
    )
    at_work = tuple(RunStatus(run, _seconds_of(run, medians, now)) for run in runs)
    if at_work:
        known = [run.seconds_left for run in at_work if run.seconds_left is not None]
        left = max(known) if known else None
    else:
        left = _seconds(Counter(todo.stage for scene in scenes for todo in scene.todo if todo.action == "run"), medians)
    return Status(scenes, at_work, left, _same(outline.states))


def _same(states: Mapping[Key, StageOutline]) -> tuple[tuple[str, ...], ...]:
    """Scenes that were made of the same scan, by id."""
    by_content: dict[str, list[str]] = {}
    for (scene, stage), state in states.items():
        content = _part(state.done, "scan") if stage == "capture" and state.done is not None else None
        if content is not None:
            by_content.setdefault(content, []).append(scene)
    return tuple(sorted(tuple(sorted(scenes)) for scenes in by_content.values() if len(scenes) > 1))


def recorded_states(states: Mapping[Key, StageOutline]) -> dict[str, dict[str, str]]:
    """What the lake says of every stage of every scene: `done`, `failed`, `lost` (older rows kept, or not) or `withdrawn`."""
    recorded: dict[str, dict[str, str]] = {}
    for (scene, stage), state in sorted(states.items()):
        if stage not in _ABOVE:  # a batch's, which is no scene
            continue
        if state.last.outcome != "done":
            text = state.last.outcome + (" (older rows kept)" if state.done is not None else "")
        else:
            text = "done" if state.done is not None else "withdrawn"
        recorded.setdefault(scene, {})[stage] = text
    return recorded


def errors(states: Mapping[Key, StageOutline]) -> list[str]:
    """What failed or was lost the last time that it was run, a line each; of batches, too."""
    wrong = [(key, state.last) for key, state in states.items() if state.last.outcome in ("failed", "lost")]
    return [f"{scene}: {stage}: {last.error}" for (scene, stage), last in sorted(wrong, key=lambda item: item[0])]


_Work = tuple[str | None, float]
"""What a worker is at: the stage, None where the lake does not tell, and since when."""


def _at_work(
    claims: Mapping[str, Claim], runs: Sequence[LiveRun], by_scene: Mapping[str, Mapping[str, StageOutline]]
) -> dict[str, _Work | None]:
    """The claimed scenes that a worker is at; None: the history has to say at which stage. The others wait for one.

    Runs claim scenes ahead of their workers. Those that do not tell what they are at have no more scenes at work than
    workers: those that got on since they were claimed, then those that were claimed first.
    """
    working: dict[str, _Work | None] = {}
    for run in runs:
        working |= {scene: work for scene, work in (run.at_work or {}).items() if scene in claims}
    silent = [run for run in runs if run.at_work is None]
    if runs and not silent:
        return working
    # A run that says nothing of its runner is none that claims ahead.
    places = sum(run.workers for run in silent) if silent and all(run.runner for run in silent) else len(claims)

    def rank(scene: str) -> tuple[bool, float, str]:
        return (not _since_claim(by_scene.get(scene, {}), claims[scene].since), claims[scene].since, scene)

    return working | dict.fromkeys(sorted(claims.keys() - working.keys(), key=rank)[:places])


def _since_claim(past: Mapping[str, StageOutline], since: float) -> dict[str, float]:
    """Stages that were done since a claim, and when each ended."""
    lasts = {stage: state.last for stage, state in past.items()}
    return {stage: last.started + last.seconds for stage, last in lasts.items() if last.started >= since and last.outcome == "done"}


def _scene_status(
    scene_id: str, past: Mapping[str, StageOutline], claim: Claim | None, work: _Work | Literal["waits"] | None, brought: Expected
) -> SceneStatus:
    is_import = "capture" in past and any(part.startswith("import=") for part in past["capture"].last.parts)
    todo = _imported(past) if is_import else _todo(scene_id, past, brought)
    if claim is not None and work != "waits":
        stage, since = work or _stage_at_work(past, todo, claim.since)
        return SceneStatus(scene_id, "running", todo, claim, stage, since)
    state: State = "done"
    if any(item.has_failed for item in todo):
        state = "failed"
    elif any(item.is_redone for item in todo):
        state = "stale"
    elif todo:
        state = "unfinished"
    return SceneStatus(scene_id, state, todo, claim)


def _imported(past: Mapping[str, StageOutline]) -> tuple[Todo, ...]:
    """What is wrong with a scene that was made elsewhere and imported: no run of ours computes it."""
    items = []
    for stage, state in past.items():
        if state.last.outcome != "done":
            items.append(Todo(stage, "report", f"{state.last.outcome} when it was imported", has_failed=True))
        elif state.done is None:
            items.append(Todo(stage, "report", "withdrawn"))
    return tuple(items)


def _todo(scene_id: str, past: Mapping[str, StageOutline], brought: Expected) -> tuple[Todo, ...]:
    """The stages of a scene that are not simply done, by the rules of `flows.run.plan`."""
    prints: dict[str, str] = {}
    todo: dict[str, Todo] = {}
    for stage in SCENE_STAGES:
        name, state = stage.name, past.get(stage.name)
        stuck = [other for other in _ABOVE[name] if other in todo and todo[other].action != "run"]
        if stuck:
            todo[name] = Todo(name, "wait", f"{', '.join(stuck)} did not succeed")
            continue
        prints[name] = _NEW
        if state is None or any(prints[other] == _NEW for other in _ABOVE[name]):
            redone = [other for other in _ABOVE[name] if other in todo]
            why = f"{', '.join(redone)} will be redone" if redone else "never done"
            has_rows, has_failed = (state.done is not None, state.last.outcome == "failed") if state is not None else (False, False)
            todo[name] = Todo(name, "run", why, has_rows, has_failed)
            continue
        brings = _brought(stage, scene_id, prints, brought)
        done, last = state
        if done is not None and _fits(done, brings, stage, last):
            prints[name] = done.fingerprint
            continue
        has_failed, is_same = last.outcome == "failed", _fits(last, brings, stage, last)
        if is_same:
            prints[name] = last.fingerprint
        if is_same and has_failed:
            todo[name] = Todo(name, "report", "failed before on the same input", has_failed=True)
        elif is_same and last.outcome == "lost":
            todo[name] = Todo(name, "run", "lost before", done is not None)
        else:
            todo[name] = Todo(name, "run", _why(stage, state, brings, todo), done is not None, has_failed)
    return tuple(todo.values())


def _brought(stage: Stage, scene_id: str, prints: Mapping[str, str], brought: Expected) -> list[str]:
    """Parts that a stage's fingerprint would have now, but for those that are taken as they were, in the order of a plan's."""
    parts = [f"annotations={brought.annotations.get(scene_id, '')}"] if stage.history else []
    parts += [f"{above}={prints[above]}" for above in _ABOVE[stage.name]]
    facts = (brought.config.get(stage.name), brought.code[stage.name], brought.seed)
    return parts + [part for part in facts if part is not None]


def _fits(run: Execution, brings: Sequence[str], stage: Stage, last: Execution) -> bool:
    """Whether a run had what the next one would have: what that brings along, and all else as the newest had it."""
    return all(part in run.parts for part in brings) and (run is last or not _outdated(run, brings, stage, last))


def _outdated(run: Execution, brings: Sequence[str], stage: Stage, last: Execution) -> list[str]:
    """Names of the parts that the newest run had and an earlier one had otherwise, of those that are taken as they were."""
    named = {part.partition("=")[0] for part in brings}
    taken = [name for name in (*stage.outside, "config", "seed") if name not in named]
    return [name for name in taken if _part(run, name) != _part(last, name)]


def _part(run: Execution, name: str) -> str | None:
    return next((part for part in run.parts if part.startswith(f"{name}=")), None)


def _why(stage: Stage, state: StageOutline, brings: Sequence[str], todo: Mapping[str, Todo]) -> str:
    """Why a stage will be computed that was not lost."""
    redone = [other for other in _ABOVE[stage.name] if other in todo]
    if redone:
        return f"{', '.join(redone)} will be redone"
    before = state.done or state.last
    names = [part.partition("=")[0] for part in brings if part not in before.parts]
    names += _outdated(before, brings, stage, state.last)
    return f"{', '.join(sorted(names, key=_ORDER.index))} changed" if names else "withdrawn"


def _stage_at_work(past: Mapping[str, StageOutline], todo: Sequence[Todo], since: float) -> _Work:
    """The first stage after those that were done since the claim which is still to do, None where the lake does not tell; it
    began when the last of them ended, or with the claim."""
    names = list(_ABOVE)
    fresh = _since_claim(past, since)
    last = max((names.index(stage) for stage in fresh), default=-1)
    return next((item.stage for item in todo if names.index(item.stage) > last), None), max(fresh.values(), default=since)


def _seconds_of(run: LiveRun, medians: Mapping[str, float], now: float) -> float | None:
    """The time that a run still takes: what is left of it, by as many at once as it has managed so far."""
    work = _seconds(run.left, medians)
    if not work:
        return work
    elapsed = max(0.0, now - run.started_at.timestamp())
    # What is under way is not done yet: at the start nothing is. So each worker counts for one scene more, which wears off.
    scene = sum(medians.values())
    return work / max((run.seconds_done + run.workers * scene) / (elapsed + scene), 1e-3) if scene else 0.0


def _seconds(left: Mapping[str, int], medians: Mapping[str, float]) -> float | None:
    """Time of stage runs one after another [s]; a stage that was never timed takes as long as the mean of the others."""
    if not sum(left.values()):
        return 0.0
    if not medians:
        return None
    usual = sum(medians.values()) / len(medians)
    return sum(count * medians.get(stage, usual) for stage, count in left.items())


def when(seconds: float) -> datetime:
    """A time of the lake's files as a date."""
    return datetime.fromtimestamp(seconds, UTC)
