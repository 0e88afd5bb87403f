"""What a run did, as a value that a scheduler can read."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING

from flows.run.plan import Plan
from schemas.wording.notes import is_expected

if TYPE_CHECKING:
    from flows.run.fanout.coordinator import RunOutcome
    from warehouse.lake import Lake


@dataclasses.dataclass(frozen=True)
class RunReport:
    """Scenes computed, failed and left as they were, and one line per failure.

    `shared` scenes were computed by another run meanwhile. `postponed` ones were not begun, for the reason in `stopped`.
    `known` failures are those of earlier runs on unchanged input; `retried` says which workers were lost. `broken` are those
    failures that are checks which an export did not pass: its scene is done all the same. `same`: scans that are scenes of another
    name, by the names that they were given under; what came of them is told under the scene's. `rescans` are scenes that were held
    against an earlier scan of their room. `refused` are the failures that are scans which cannot be used.
    """

    done: tuple[str, ...]
    failed: tuple[str, ...]
    unchanged: tuple[str, ...]
    failures: tuple[str, ...]
    steps: int
    degradations: tuple[str, ...]
    shared: tuple[str, ...] = ()
    postponed: tuple[str, ...] = ()
    stopped: str | None = None
    known: tuple[str, ...] = ()
    retried: tuple[str, ...] = ()
    broken: tuple[str, ...] = ()
    same: dict[str, str] = dataclasses.field(default_factory=dict)
    rescans: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()


def broken_checks(lake: Lake, scenes: Collection[str] | None = None) -> dict[str, tuple[str, ...]]:
    """Checks that exports in the lake did not pass, by scene, of `scenes` if given: a line each that names format and rule."""
    if not lake.exists or (scenes is not None and not scenes):
        return {}
    broken: dict[str, tuple[str, ...]] = {}
    # Without SQL: its views read the footers of all tables first. Files in which all have passed are not read.
    for row in lake.snapshot().matching("export_checks", {"passed": {False}}, ["passed", "message"]).to_pylist():
        scene = row["scene_id"]
        if scenes is None or scene in scenes:
            text = " ".join(str(row["message"]).split())
            broken[scene] = (*broken.get(scene, ()), f"{scene}: exports: {row['format']} breaks the rule {row['rule']}: {text}")
    return broken


def report_of(
    plan: Plan,
    outcome: RunOutcome | None = None,
    began: datetime | None = None,
    broken: Mapping[str, Sequence[str]] | None = None,
    refused_before: Collection[str] = (),
) -> RunReport:
    """The report of a plan; `outcome` is what came of the scenes that it computed, `broken` the checks of their exports.
    `refused_before` are the lines of scans that an earlier run refused for the same reason.

    What failed since `began` is this run's failure, although the plan found it in the lake: the run had to start over.
    """
    from flows.scans.mirror import FetchError

    results = sorted(outcome.results, key=lambda result: result.scene_id) if outcome else []
    elsewhere = outcome.failed_elsewhere if outcome else {}
    shared, postponed = (set(outcome.shared), set(outcome.postponed)) if outcome else (set(), set())
    computed = {result.scene_id for result in results}
    failed = {r.scene_id for r in results if r.failed} | {s.scan.scene_id for s in plan.scenes if s.failure} | set(elsewhere)
    known: list[str] = []
    anew: list[str] = []
    refused = tuple(str(error) for error in plan.unusable if not isinstance(error, FetchError))
    for error in plan.unusable:
        (known if str(error) in refused_before else anew).append(str(error))
    for scene in plan.scenes:
        step = scene.failure
        if step is not None and step.before is not None:
            is_new = began is not None and step.before.started_at >= began
            (anew if is_new else known).append(f"{scene.scan.scene_id}: {step.stage}: {step.before.error}")
    known += [f"{scene}: {text}" for scene, text in sorted(elsewhere.items())]
    anew += [f"{r.scene_id}: {r.failed}: {r.error}" for r in results if r.failed]
    lines = [(scene, line) for scene, degradations in sorted((broken or {}).items()) for line in degradations]
    known += [line for scene, line in lines if scene not in computed]
    anew += [line for scene, line in lines if scene in computed]
    degradations = {r.scene_id: r.degradations for r in results}
    notes = [line for line in plan.left_out if not _is_told(line, plan.same, degradations)]  # first: of what follows most is cut off
    # Conditions of every scan of a kind stay in the lake alone.
    notes += [text for r in results for text in r.degradations if not is_expected(text)]
    settled = computed | failed | shared | postponed
    return RunReport(
        done=tuple(r.scene_id for r in results if not r.failed),
        failed=tuple(sorted(failed)),
        unchanged=tuple(s.scan.scene_id for s in plan.scenes if s.scan.scene_id not in settled),
        failures=(*known, *anew),
        steps=sum(len(r.ran) for r in results),
        degradations=tuple(notes),
        shared=tuple(sorted(shared)),
        postponed=tuple(sorted(postponed)),
        stopped=outcome.stopped if outcome else None,
        known=tuple(known),
        retried=tuple(outcome.retried) if outcome else (),
        broken=tuple(line for _, line in lines),
        same=dict(plan.same),
        refused=refused,
    )


def _is_told(line: str, same: Mapping[str, str], degradations: Mapping[str, Sequence[str]]) -> bool:
    """Whether a line of `Plan.left_out` is among what its scene's stages said."""
    scan, _, note = line.partition(": ")
    return any(note in text for text in degradations.get(same.get(scan, scan), ()))


_kept: list[RunReport] = []


def keep(report: RunReport) -> None:
    """Keep the report of the run that ends now: a server that is away then makes Prefect forget it."""
    _kept[:] = [report]


def kept() -> RunReport | None:
    """The report that was kept, once."""
    return _kept.pop() if _kept else None
