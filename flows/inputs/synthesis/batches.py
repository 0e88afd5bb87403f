"""Many scenes of one request: which are missing, drawn in blocks, made by workers, committed block by block."""

from __future__ import annotations

import dataclasses
import re
import time
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping
from datetime import UTC, datetime
from typing import Any, Literal

from flows.inputs.synthesis.asking import AskedScene, content_of
from flows.inputs.synthesis.jobs import BACK, FRONT, SceneDone, SynthesisJob
from flows.inputs.synthesis.models import DrawingModel
from flows.inputs.synthesis.workers import Make, makers
from flows.progress import Progress
from flows.run.configuration import configure
from flows.run.fingerprints import Fingerprint, canonical_json, code_fingerprint, digest
from flows.run.plan import annotation_digests
from flows.worker import Job, lost_run
from schemas.candidates import Asset
from schemas.errors import InputError
from schemas.record import arrow_to_rows
from tasks.pipeline import MODULES, STAGES, upstream
from tasks.stage import Stage
from tasks.synthesis.layout import UNKNOWN_ROOM
from tasks.synthesis.scenes.assets import MADE_LICENSE, Pool, chosen_assets
from tasks.synthesis.scenes.drawn import Drawn, usable
from warehouse.lake import Lake
from warehouse.release.licenses import Allowed, duties
from warehouse.tables.history import BASED_ON, Key, StageState

BLOCK = 16
"""Scenes that are drawn and committed together: models draw so many side by side, and a commit costs less than a second."""

LOOK_SECONDS = 1.0
"""How long scenes that another command is at are left alone before they are looked at again."""

MOST = 100_000
"""Scenes of one request."""

DATASET = "synthetic"
"""Of drawn scenes, unless they are to have another."""

_CODE = "tasks.synthesis.scenes.rows"
_MARK = "synthesis="

Action = Literal["draw", "go on", "reuse", "report"]


@dataclasses.dataclass(frozen=True)
class SceneSynthesis:
    """A scene and what is to be done with it, or was: `draw` it, `go on` with its stages, `reuse` it, `report` its failure.

    Figures as `SceneDone` has them; None of what was not made now.
    """

    scene_id: str
    number: int
    action: Action
    why: str
    done: SceneDone | None = None
    error: str | None = None


@dataclasses.dataclass(frozen=True)
class Synthesized:
    """What came of a request: its scenes by number."""

    model_id: str
    model_kind: str
    seed: int
    scenes: tuple[SceneSynthesis, ...]

    @property
    def failed(self) -> tuple[SceneSynthesis, ...]:
        """Scenes that are not in the lake to the last stage."""
        return tuple(scene for scene in self.scenes if scene.error is not None)


@dataclasses.dataclass(frozen=True)
class _Request:
    """All that scenes of a request have in common. choice: What was said of assets, nothing where nothing was."""

    lake: Lake
    asked: AskedScene
    model: DrawingModel
    seed: int
    dataset: str
    name: str
    pool: Pool
    license: str | None
    choice: Mapping[str, Any]

    @property
    def facts(self) -> str:
        """The request as JSON text; with the number it decides what is drawn."""
        return canonical_json({"synthesis": {**self.asked.facts, "model": self.model.model_id, "seed": self.seed, **self.choice}})

    def scene_id(self, number: int) -> str:
        """Of a layout."""
        return f"{self.dataset}/{self.name}_{number:04d}"


def synthesize(
    lake: Lake, wanted: AskedScene, model: DrawingModel, *, count: int, seed: int = 0, dataset: str = DATASET, name: str = "",
    use_assets: bool = True, licenses: Allowed | None = None, workers: int = 0, dry_run: bool = False, retry_failed: bool = False,
) -> Synthesized:  # fmt: skip
    """Draw layouts 0 to `count` - 1 of a request, and put them through the stages; what is there already is not made again.

    use_assets: Take assets of the lake where they fit; licenses: of these, those that may be taken. workers: Processes that make scenes;
    with 0 this process does, and what takes it along takes all along.

    Raises:
        InputError: the model does not know the large object or the kind of room, or the name is that of other scenes.
    """
    # Nobody chose the kind of room of a scene that is there: one that the model does not know is none to it.
    large = wanted.large(seed, 0)
    model.drawer.check(large if wanted.base is None else dataclasses.replace(large, room_type=UNKNOWN_ROOM))
    if not 1 <= count <= MOST:
        raise InputError("--count", str(count), "is no number of scenes", f"give 1 to {MOST}")
    if not re.fullmatch(r"[a-z0-9][a-z0-9_.-]{0,63}", dataset):
        raise InputError("--dataset", dataset, "is no name for a dataset", "use up to 64 small letters, digits, and _ . - after the first")
    if name and not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", name):
        raise InputError("--name", name, "is no name for scenes", "use up to 64 letters, digits, and _ . - after the first")
    pool = _pool(lake, licenses) if use_assets else Pool()
    choice = {"assets": "made"} if not use_assets else {"licenses": sorted(licenses.names)} if licenses is not None else {}
    common = _Request(lake, wanted, model, seed, dataset, name, pool, _license(model, wanted), choice)
    if not name:
        common = dataclasses.replace(common, name=_own_name(common))
    history = lake.history()
    _check_name(history, common)
    planned = {plan.number: (plan, job) for plan, job in _planned(common, history, range(count), retry_failed)}
    if not dry_run:
        staged = {scene for (scene, _), state in history.items() if state.is_staged}
        for made in _made(common, planned, staged, workers, retry_failed):
            planned[made.number] = made, planned[made.number][1]
    return Synthesized(model.model_id, model.kind, seed, tuple(planned[number][0] for number in range(count)))


def _made(
    common: _Request, planned: Mapping[int, tuple[SceneSynthesis, SynthesisJob]], staged: Collection[str], workers: int, retry_failed: bool
) -> Iterator[SceneSynthesis]:
    """Make what is missing, a block at a time; what a killed command staged before is committed too.

    Scenes are claimed before they are made. Those that another command is at come last, and are looked at again until it gives them back.
    """
    todo = [number for number, (plan, _) in planned.items() if plan.action in ("draw", "go on")]
    waiting = [plan.scene_id for plan, _ in planned.values() if plan.scene_id in staged and plan.action in ("reuse", "report")]
    note, began = f"synthesis of {common.dataset}/{common.name} by {common.model.kind}", datetime.now(UTC)
    if not todo:
        if waiting:
            common.lake.commit(note, scenes=set(waiting) - common.lake.claimed().keys())
        return
    blocks = deque([number for number in todo if number // BLOCK == block] for block in sorted({number // BLOCK for number in todo}))
    with Progress("scenes", len(todo)) as progress, common.lake.claims() as claims, makers(min(workers, len(todo))) as make:
        while blocks:
            numbers = blocks.popleft()
            ours = [number for number in numbers if claims.claim(common.scene_id(number))]
            if len(ours) < len(numbers):
                blocks.append([number for number in numbers if number not in ours])
            if not ours:
                time.sleep(LOOK_SECONDS)
                continue
            for made in _block(common, ours, make, retry_failed, began):
                progress.advance(made.scene_id)
                yield made
            names = [common.scene_id(number) for number in ours]
            common.lake.commit(note, scenes=[*(set(waiting) - common.lake.claimed().keys()), *names])
            _check_base(common, is_erased=True)
            waiting = []
            for name in names:
                claims.release(name)


def _block(common: _Request, numbers: Collection[int], make: Make, retry_failed: bool, began: datetime) -> Iterator[SceneSynthesis]:
    """Scenes that are claimed: planned again, as another command may have made them since, then drawn side by side, and made.

    Raises:
        InputError: the scene that they are based on was changed or erased meanwhile, or another request drew scenes of their names.
    """
    _check_base(common)
    history = common.lake.history({common.scene_id(number) for number in numbers})
    _check_name(history, common)
    planned = {plan.number: (plan, job) for plan, job in _planned(common, history, numbers, retry_failed, began)}
    todo = {number: job for number, (plan, job) in planned.items() if plan.action in ("draw", "go on")}
    yield from (plan for number, (plan, _) in planned.items() if number not in todo)
    jobs, problems = _with_layouts(common, todo)
    for number, problem in problems.items():
        first = todo[number].jobs[0]
        common.lake.stage_rows(lost_run(first, "input", problem, 0.0), {})
        yield dataclasses.replace(planned[number][0], error=f"{first.stage}: {problem}")
    for number, done in zip(jobs, make(list(jobs.values())), strict=True):
        yield dataclasses.replace(planned[number][0], done=done, error=done.error)


def _check_base(common: _Request, *, is_erased: bool = False) -> None:
    """Refuse to go on where the scene that others are based on was changed; with `is_erased` only where it was erased: what was made of it
    after that is in no snapshot.

    Raises:
        InputError: it was.
    """
    base = common.asked.base
    content = content_of(common.lake.snapshot(), base.scene.scene_id) if base is not None else ()
    if base is not None and (not content if is_erased else content != common.asked.content):
        what, to_do = ("changed", "give the same command again") if content else ("erased", "furnish another one")
        raise InputError("--instance", f"{base.scene.scene_id}/{base.instance_id}", f"its scene was {what} meanwhile", to_do)


def _with_layouts(common: _Request, jobs: Mapping[int, SynthesisJob]) -> tuple[dict[int, SynthesisJob], dict[int, str]]:
    """Jobs with the layouts that they need, by number; and which cannot be made, and why."""
    numbers = [number for number, job in jobs.items() if FRONT[0] in job.todo]
    started = time.perf_counter()
    layouts = (
        common.model.drawer.draw([common.asked.large(common.seed, number) for number in numbers], common.seed, numbers) if numbers else []
    )
    seconds = (time.perf_counter() - started) / max(len(numbers), 1)
    made, problems = dict(jobs), {}
    for number, layout in zip(numbers, layouts, strict=True):
        try:
            sound = usable(layout)
        except InputError as error:
            problems[number] = str(error)
            del made[number]
            continue
        drawn = Drawn(
            jobs[number].scene_id, sound, common.asked.word, common.model.model_id, common.model.kind, common.seed, number, common.license,
            seconds,
        )  # fmt: skip
        made[number] = dataclasses.replace(
            jobs[number], drawn=drawn, chosen=tuple(chosen_assets(drawn, common.pool, common.asked.base is None))
        )
    return made, problems


def _planned(
    common: _Request, history: Mapping[Key, StageState], numbers: Iterable[int], retry_failed: bool, began: datetime | None = None
) -> Iterator[tuple[SceneSynthesis, SynthesisJob]]:
    """What to do with every scene, and why; nothing is computed. What failed since the command began is not tried again."""
    configs = configure(seed=common.seed).stages
    codes = {name: code_fingerprint(MODULES[name]) for name in BACK}
    front_code = digest(code_fingerprint(_CODE), common.model.code)
    front = digest(
        "synthesis-1", common.facts, *common.asked.content, *common.pool.asset_ids, str(common.license), front_code,
        canonical_json(configs["optimization"]),
    )  # fmt: skip
    stages = [stage for stage in STAGES if stage.name in (*FRONT, *BACK)]
    numbers, base = list(numbers), common.asked.base
    of = (f"{BASED_ON}{base.scene.scene_id}",) if base is not None else ()
    annotations = annotation_digests(common.lake, {common.scene_id(number) for number in numbers})
    for number in numbers:
        scene_id = common.scene_id(number)
        jobs: dict[str, Job] = {}
        for stage in stages:
            above = tuple(f"{other.name}={jobs[other.name].fingerprint}" for other in upstream(stage) if other.name in jobs)
            facts = (f"request={digest(common.facts)[:16]}", f"model={common.model.model_id}", f"number={number}", *of)
            if stage.name in FRONT:
                content = digest(front, str(number))
                parts: tuple[str, ...] = (
                    f"{_MARK}{content}",
                    f"config={digest(common.facts)}",
                    f"code={front_code}",
                    f"seed={common.seed}",
                    *facts,
                )
                fingerprint, text = digest("synthesis-1", stage.name, content), common.facts
            else:
                text = canonical_json(configs[stage.name])
                beside = (f"annotations={annotations.get(scene_id, '')}",) if stage.history else ()
                print_ = Fingerprint((*beside, *above), text, codes[stage.name], common.seed, facts)
                fingerprint, parts = print_.value, print_.parts
            jobs[stage.name] = _job(common, scene_id, stage, configs[stage.name], text, fingerprint, parts, above, history)
        yield _plan(common, scene_id, number, tuple(jobs.values()), history, retry_failed, began)


def _job(
    common: _Request, scene_id: str, stage: Stage, config: object, text: str, fingerprint: str, reasons: tuple[str, ...],
    above: tuple[str, ...], history: Mapping[Key, StageState],
) -> Job:  # fmt: skip
    state = history.get((scene_id, stage.name))
    attempt = state.last.attempt + 1 if state is not None and state.last.fingerprint == fingerprint else 1
    return Job(common.lake.address, scene_id, stage.name, config, text, common.seed, fingerprint, reasons, above, attempt)


def _plan(
    common: _Request, scene_id: str, number: int, jobs: tuple[Job, ...], history: Mapping[Key, StageState], retry_failed: bool,
    began: datetime | None,
) -> tuple[SceneSynthesis, SynthesisJob]:  # fmt: skip
    states = {job.stage: history.get((scene_id, job.stage)) for job in jobs}
    todo = [job.stage for job in jobs if not _is_done(states[job.stage], job)]
    if any(name in todo for name in FRONT):
        todo = [job.stage for job in jobs if job.stage in FRONT or job.stage in todo]
    made = SynthesisJob(common.lake.address, scene_id, common.dataset, jobs, tuple(todo), None, (), common.asked.base)
    if not todo:
        return SceneSynthesis(scene_id, number, "reuse", "unchanged"), made
    failed = next((job for job in jobs if job.stage in todo and _has_failed(states[job.stage], job)), None)
    last = states[failed.stage] if failed is not None else None
    if failed is not None and last is not None and (not retry_failed or (began is not None and last.last.started_at > began)):
        why = "failed before on the same input (--retry-failed makes it again)"
        return SceneSynthesis(scene_id, number, "report", why, error=f"{failed.stage}: {last.last.error or 'failed'}"), made
    action: Action = "draw" if todo[0] in FRONT else "go on"
    return SceneSynthesis(scene_id, number, action, _why(states[todo[0]], next(job for job in jobs if job.stage == todo[0]))), made


def _why(before: StageState | None, job: Job) -> str:
    """Why a stage is run."""
    if before is None:
        return "never drawn" if job.stage in FRONT else f"{job.stage} was not reached"
    if before.last.fingerprint == job.fingerprint and before.last.outcome != "done":
        return f"{job.stage}: {before.last.outcome} before"
    old, new = (dict(part.split("=", 1) for part in parts) for parts in ((before.done or before.last).reasons, job.reasons))
    changed = [part for part in new if old.get(part) != new[part] and part != _MARK.rstrip("=")]
    return f"{job.stage}: {', '.join(changed) or 'input'} changed"


def _has_failed(state: StageState | None, job: Job) -> bool:
    return state is not None and state.last.fingerprint == job.fingerprint and state.last.outcome == "failed"


def _is_done(state: StageState | None, job: Job) -> bool:
    return state is not None and state.done is not None and state.done.fingerprint == job.fingerprint


def _own_name(common: _Request) -> str:
    """A name that says what was asked for; another request has another."""
    base = common.asked.base
    of = f"{base.scene.scan[:28]}_{base.instance_id}" if base is not None else common.asked.word.replace(" ", "_")
    room = "" if common.asked.room_type == "unknown" else f"_{common.asked.room_type.replace(' ', '_')}"
    text = re.sub(r"[^A-Za-z0-9_.-]", "_", f"{of}{'' if base is not None else room}_{common.model.kind}")[:48]
    return f"{text}_{digest(common.facts)[:8]}"


def _check_name(history: Mapping[Key, StageState], common: _Request) -> None:
    """Refuse names of scenes that were captured or imported, and of scenes that another request drew: they would be replaced."""
    for (scene, stage), state in sorted(history.items()):
        if stage != FRONT[0] or not scene.startswith(f"{common.dataset}/"):
            continue
        reasons = (state.done or state.last).reasons
        if not any(part.startswith(_MARK) for part in reasons):
            raise InputError(
                "--dataset", common.dataset, f"is the dataset of {scene}, which nobody drew", "give drawn scenes another dataset"
            )
        is_ours = f"request={digest(common.facts)[:16]}" in reasons
        if not is_ours and re.fullmatch(rf"{re.escape(common.name)}_[0-9]{{4,}}", scene.partition("/")[2]):
            raise InputError("--name", common.name, f"is the name of {scene}, which another request drew", "give another name")


def _pool(lake: Lake, licenses: Allowed | None) -> Pool:
    """Assets of the lake that may stand for what is drawn."""
    assets = list(arrow_to_rows(lake.snapshot().arrow("assets"), Asset))
    return Pool([row for row in assets if licenses is None or licenses.permits(row.license)])


def _license(model: DrawingModel, wanted: AskedScene) -> str | None:
    """Of the scene: what its base and its model ask for together; free where neither asks for anything. None where nobody says."""
    stated = [model.license, *([wanted.base.scene.license] if wanted.base is not None else [])]
    if any(license_ is None for license_ in stated):
        return None
    asking = sorted({str(license_) for license_ in stated if duties(license_) != "nothing"})
    if len(asking) > 1:
        asking = [f"({license_})" if " OR " in license_.upper() else license_ for license_ in asking]
    return " AND ".join(asking) if asking else MADE_LICENSE
