"""What a run would do, and why: every (scene, stage) held against what the lake already has. Does not import Prefect."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Literal

from flows.run.configuration import Configuration
from flows.run.fingerprints import FileHashes, Fingerprint, annotations_digest, canonical_json, code_fingerprint
from flows.run.identity import Content, content_of, recorded_content, same_scenes, scan_as
from flows.run.libraries import library_input
from flows.scans.copies import apart_from_lake, incomplete_copies
from schemas.errors import InputError
from schemas.runs import StageRun
from tasks.capture.formats import survey
from tasks.capture.scan import PassedOver, Scan, UnusableScan
from tasks.pipeline import MODULES, SCENE_STAGES, upstream
from tasks.stage import Stage
from warehouse.lake import Lake
from warehouse.tables.history import StageState
from warehouse.tables.reviews import standing_answers

Action = Literal["reuse", "run", "report", "wait"]


@dataclasses.dataclass(frozen=True)
class Step:
    """One stage of one scene: what is to be done with it and why.

    `reuse`: the lake has it. `run`: it will be computed. `report`: it failed on exactly this input before, and that is
    said again. `wait`: a stage that it reads from did not succeed.
    """

    stage: str
    action: Action
    why: str
    fingerprint: Fingerprint
    upstream: tuple[str, ...]
    attempt: int
    before: StageRun | None


@dataclasses.dataclass(frozen=True)
class ScenePlan:
    """The steps of one scene, in the order of the stages. `snapshot_id` is what they were made from; None is the newest.

    `given`: the scan under its own name, where the scene has another.
    """

    scan: Scan
    steps: tuple[Step, ...]
    snapshot_id: int | None = None
    given: Scan | None = None

    @property
    def todo(self) -> tuple[Step, ...]:
        """Steps that will be computed."""
        return tuple(step for step in self.steps if step.action == "run")

    @property
    def models(self) -> dict[str, str]:
        """Ids of the models that its stages use, by stage."""
        named = [(step.stage, part.partition("=")) for step in self.steps for part in step.fingerprint.inputs]
        return {stage: value for stage, (name, _, value) in named if name == MODEL}

    @property
    def library(self) -> str:
        """What its inputs say of the library; '' where no stage takes one."""
        named = [part.partition("=") for step in self.steps for part in step.fingerprint.inputs]
        return next((value for name, _, value in named if name == LIBRARY), "")

    @property
    def failure(self) -> Step | None:
        """The step that failed before and is not computed again."""
        return next((step for step in self.steps if step.action == "report"), None)


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a run would do: scenes with their steps, and scans that cannot be used at all. `snapshot_id` is what it was made from.

    left_out: A line for each scan that has links out of the folder of scans, and for files that are passed over.
    `same`: scans that are scenes of another name, whose steps are theirs (see `flows.run.identity`); scene by the scan's own name.
    """

    scenes: tuple[ScenePlan, ...]
    unusable: tuple[InputError, ...]
    snapshot_id: int = 0
    left_out: tuple[str, ...] = ()
    same: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @property
    def todo(self) -> tuple[ScenePlan, ...]:
        """Scenes with something to compute."""
        return tuple(scene for scene in self.scenes if scene.todo)

    def counts(self) -> Counter[Action]:
        """How many steps there are of each action."""
        return Counter(step.action for scene in self.scenes for step in scene.steps)


def make_plan(
    lake: Lake,
    scans: Sequence[Scan],
    unusable: Iterable[InputError],
    configuration: Configuration,
    retry_failed: bool = False,
    hashes: FileHashes | None = None,
    *,
    again: bool = False,
    same: Mapping[str, str] | None = None,
    models: Mapping[str, str] | None = None,
) -> Plan:
    """Hold scans against the lake. Nothing is computed or written but the cache of file hashes.

    A scan that the lake has under another name is that scene, unless it is to be computed `again` under its own. `same` says
    which scans are, as `Plan.same`, where that is decided already.
    """
    hashes = hashes or FileHashes()
    reader = lake.snapshot()
    snapshot_id = reader.snapshot_id  # before the history is read: what is committed meanwhile counts as news
    stage_facts = {
        stage.name: (canonical_json(configuration.stages[stage.name]), code_fingerprint(MODULES[stage.name])) for stage in SCENE_STAGES
    }
    library = library_input(lake, configuration.library, hashes)
    scans = apart_from_lake(scans, reader) if same is None else scans
    history = lake.history({scan.scene_id for scan in scans})
    errors: list[InputError] = []
    notes: list[str] = []
    for error in unusable:
        if isinstance(error, PassedOver):
            notes.append(str(error))
        else:
            errors.append(error)
    looked: list[tuple[Scan, Content]] = []
    for scan in scans:
        try:
            files, note = survey(scan)
            looked.append((scan, content_of(scan, files, hashes)))
            notes += [f"{scan.scene_id}: {note}"] if note else []
        except OSError as error:
            unread = InputError(scan.path.name, "files", str(error), "check that they can be read")
            errors.append(UnusableScan(unread, scan.path, scan.format))
        except InputError as error:
            errors.append(UnusableScan(error, scan.path, scan.format))
    incomplete = incomplete_copies([scan for scan, _ in looked], hashes)
    looked = [(scan, content) for scan, content in looked if scan.scene_id not in incomplete]
    errors += incomplete.values()
    hashes.save()
    if same is None and not again:
        captures = {scan.scene_id: history.get((scan.scene_id, CAPTURE)) for scan, _ in looked}
        same = same_scenes(lake, {scan.scene_id: content for scan, content in looked}, captures)
    same = same or {}
    given: Mapping[str, Scan] = {}
    if same:
        history |= lake.history(set(same.values()) - {scan.scene_id for scan in scans})
        looked, given = _as_scenes(lake, looked, same, history)
    models = wanted_models(lake, configuration) if models is None else models
    annotations = annotation_digests(lake, {scan.scene_id for scan, _ in looked}, snapshot_id)
    scenes = []
    for scan, content in looked:
        outside = {SCAN: content.named, LIBRARY: library}
        past = {stage.name: history.get((scan.scene_id, stage.name)) for stage in SCENE_STAGES}
        facts = {SCAN: content.parts[1:]}
        given_to = {stage.name: _given(stage, outside, models, configuration) for stage in SCENE_STAGES}
        steps = _steps(given_to, facts, annotations.get(scan.scene_id, ""), past, stage_facts, configuration.seed, retry_failed)
        scenes.append(ScenePlan(scan, steps, snapshot_id, given.get(scan.scene_id)))
    return Plan(tuple(scenes), tuple(errors), snapshot_id, tuple(notes), same)


def planned_again(lake: Lake, scene: ScenePlan, configuration: Configuration, retry_failed: bool = False) -> ScenePlan | None:
    """The plan of a scene as the lake is now, under the name that it has; None when its scan cannot be read.

    What a scan is called is decided once, and so is which model is the newest. Its files are looked at under its own name, which is a
    part of their paths.
    """
    given = scene.given or scene.scan
    same = {given.scene_id: scene.scan.scene_id} if scene.given else {}
    return next(iter(make_plan(lake, [given], (), configuration, retry_failed, same=same, models=scene.models).scenes), None)


LIBRARY = "library"
"""The outside input that candidates are retrieved from."""

MODEL = "model"
"""The outside input that is a model of the lake or of the package, by its id."""

SCAN = "scan"
"""The outside input that is the scan."""

CAPTURE = "capture"
"""The stage that reads scans, and whose rows say which content they are of."""


def _given(stage: Stage, outside: Mapping[str, str], models: Mapping[str, str], configuration: Configuration) -> dict[str, str]:
    """Hashes of the outside inputs that a stage is given, by name."""
    given = {name: value for name, value in outside.items() if name != SCAN or stage.takes_scan(configuration.stages[stage.name])}
    return given | ({MODEL: models[stage.name]} if stage.name in models else {})


def _as_scenes(
    lake: Lake, looked: Sequence[tuple[Scan, Content]], same: Mapping[str, str], history: Mapping[tuple[str, str], StageState]
) -> tuple[list[tuple[Scan, Content]], dict[str, Scan]]:
    """Scans under the names of the scenes that they are, each scene once, by scene id; and those that had others, as they were."""
    rows = lake.snapshot().matching("scenes", {"scene_id": set(same.values())}, ["dataset", "scan"]).to_pylist()
    names = {row["scene_id"]: (row["dataset"], row["scan"]) for row in rows}
    chosen = {scan.scene_id: (scan, content) for scan, content in looked if scan.scene_id not in same}
    given = {}
    for scan, content in looked:
        scene = same.get(scan.scene_id)
        if scene is None or scene in chosen:
            continue
        # Paths are a part of the recorded hash: those of a scan that was renamed since have changed, and its content has not.
        state = history.get((scene, CAPTURE))
        recorded = recorded_content(state.done or state.last) if state is not None else ""
        chosen[scene] = scan_as(scan, scene, *names.get(scene, ("", ""))), content._replace(named=recorded or content.named)
        given[scene] = scan
    return [chosen[scene] for scene in sorted(chosen)], given


def _steps(
    outside: Mapping[str, Mapping[str, str]],
    facts: Mapping[str, tuple[str, ...]],
    annotations: str,
    past: Mapping[str, object],
    stage_facts: Mapping[str, tuple[str, str]],
    seed: int,
    retry_failed: bool,
) -> tuple[Step, ...]:
    """The steps of one scene. `outside` holds hashes of outside inputs by stage, `stage_facts` config and code of every stage, the same
    texts for all scenes; `facts` what capture is to record beside an outside input."""
    steps: list[Step] = []
    by_stage: dict[str, Step] = {}
    for stage in SCENE_STAGES:
        above = upstream(stage)
        above = tuple(other for other in above if other.grain == "scene")
        read = tuple(f"{other.name}={by_stage[other.name].fingerprint.value}" for other in above)
        inputs = tuple(f"{name}={outside[stage.name][name]}" for name in stage.outside if name in outside[stage.name])
        if stage.history:
            inputs += (f"annotations={annotations}",)
        beside = tuple(fact for name in stage.outside for fact in facts.get(name, ())) if stage.name == CAPTURE else ()
        fingerprint = Fingerprint((*inputs, *read), *stage_facts[stage.name], seed, beside)
        action, why, attempt, before = _action(stage, fingerprint, past[stage.name], [by_stage[o.name] for o in above], retry_failed)
        step = Step(stage.name, action, why, fingerprint, read, attempt, before)
        steps.append(step)
        by_stage[stage.name] = step
    return tuple(steps)


def _action(
    stage: Stage, fingerprint: Fingerprint, past: object, above: Sequence[Step], retry_failed: bool
) -> tuple[Action, str, int, StageRun | None]:
    """What to do with a step, why, as which attempt, and the run that says so."""
    done: StageRun | None = getattr(past, "done", None)
    last: StageRun | None = getattr(past, "last", None)
    value = fingerprint.value
    stuck = [step.stage for step in above if step.action in ("report", "wait")]
    if stuck:
        return "wait", f"{', '.join(stuck)} did not succeed", 1, None
    if done is not None and done.fingerprint == value:
        return "reuse", "unchanged", done.attempt, done
    attempt = last.attempt + 1 if last is not None and last.fingerprint == value else 1
    if last is not None and last.fingerprint == value and last.outcome == "failed" and not retry_failed:
        return "report", "failed before on the same input (--retry-failed computes it again)", last.attempt, last
    if last is not None and last.fingerprint == value and last.outcome in ("failed", "lost"):
        return "run", f"{last.outcome} before", attempt, last
    redone = [step.stage for step in above if step.action == "run"]
    if redone:
        return "run", f"{', '.join(redone)} will be redone", attempt, last
    before = done or last
    if before is None:
        return "run", "never done", attempt, None
    changed = [name for name in fingerprint.changes(before.reasons) if name]
    return "run", f"{', '.join(changed) or 'result'} changed", attempt, before


def wanted_models(lake: Lake, configuration: Configuration) -> dict[str, str]:
    """Id of the model that each stage is to use, by stage; no entry for stages whose configs ask for none.

    Raises:
        InputError: there is no such model, or it was withdrawn.
    """
    asked = {
        stage.name: wanted
        for stage in SCENE_STAGES
        if stage.model_wanted is not None and (wanted := stage.model_wanted(configuration.stages[stage.name])) is not None
    }
    if not asked:
        return {}
    from flows.training.models import wanted_model

    reader = lake.snapshot()
    return {name: wanted_model(reader, wanted).model_id for name, wanted in asked.items()}


def annotation_digests(lake: Lake, scenes: Collection[str] | None = None, snapshot_id: int | None = None) -> dict[str, str]:
    """Hash of each scene's annotations that count in a snapshot, of `scenes` if given; no entry where there are none."""
    per_scene: dict[str, list[Mapping[str, object]]] = {}
    only = next(iter(scenes)) if scenes is not None and len(scenes) == 1 else None  # a scene is planned again: not all is read
    for row in standing_answers(lake.snapshot(snapshot_id), only).to_pylist():
        if scenes is None or row["scene_id"] in scenes:
            per_scene.setdefault(row["scene_id"], []).append(row)
    return {scene: annotations_digest(rows) for scene, rows in per_scene.items()}
