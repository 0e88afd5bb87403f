"""What came of a run, for people: a row per scene, and a summary in Markdown. Does not import Prefect."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from schemas.wording import counted

if TYPE_CHECKING:
    from flows.run.plan import Plan
    from flows.run.report import RunReport
    from schemas.runs import StageRun
    from warehouse.lake import Lake

MAX_NOTES = 20
"""Degradations, failures and retries in the summary; the first ones say what kind they are."""

ORDER = ("failed", "postponed", "shared", "done", "skipped")
"""States of scenes, those first that want something of the reader."""


def scene_rows(
    report: RunReport, plan: Plan, runs: Mapping[tuple[str, str], StageRun], formats: Mapping[str, str] | None = None
) -> list[dict[str, Any]]:
    """One row per scene of a run and per scan that cannot be used, failed ones first: state, stage, why, seconds, exports."""
    formats = formats or {}
    failures = _failure_of(report)
    plans = {scene.scan.scene_id: scene for scene in plan.scenes}
    given: dict[str, list[str]] = {}
    for scan, scene_id in report.same.items():
        given.setdefault(scene_id, []).append(scan)
    named = dict(zip(ORDER, (report.failed, report.postponed, report.shared, report.done, report.unchanged), strict=True))
    rows = [_row(str(error.file), "failed", "", str(error)) for error in plan.unusable]
    for state, scenes in named.items():
        for scene_id in sorted(scenes):
            steps = plans[scene_id].todo if scene_id in plans else ()
            stage, why = "", ""
            if state == "failed":
                stage, why = failures.get(scene_id, ("", ""))
            elif state == "postponed":
                why = report.stopped or ""
            elif state == "shared":
                why = "another run computed it"
            elif state == "skipped":
                why = "up to date" + (f"; given as {', '.join(given[scene_id])}" if scene_id in given else "")
            elif steps:
                stage = steps[0].stage if len(steps) == 1 else f"{steps[0].stage} to {steps[-1].stage}"
                why = steps[0].why
            mine = [run.seconds for step in steps if (run := runs.get((scene_id, step.stage))) is not None]
            rows.append(_row(scene_id, state, stage, why, round(sum(mine), 2) if mine else None, formats.get(scene_id, "")))
    return rows


def _row(scene: str, state: str, stage: str, why: str, seconds: float | None = None, exports: str = "") -> dict[str, Any]:
    return {"Scene": scene, "State": state, "Stage": stage, "Seconds": seconds, "Why": why, "Exports": exports}


def run_markdown(report: RunReport, plan: Plan, runs: Mapping[tuple[str, str], StageRun], lake: str) -> str:
    """A run as Markdown: counts, what went wrong, where the time went, what to do next."""
    counts = {
        "done": len(report.done),
        "failed": len(report.failed),
        "checks of exports that failed": len(report.broken),
        "scans that cannot be used": len(plan.unusable),
        "up to date": len(report.unchanged),
        "scans known under another name": len(report.same),
        "computed by another run": len(report.shared),
        "postponed": len(report.postponed),
        "stage runs": report.steps,
        "degradations": len(report.degradations),
        "workers lost and replaced": len(report.retried),
    }
    parts = [_grid(("scenes", "how many"), [(name, f"{count:,}") for name, count in counts.items() if count or name == "done"])]
    if report.stopped:
        parts += ["## Stopped early", _code(report.stopped)]
    for title, lines in (("Failed", report.failures), ("Retried", report.retried), ("Degradations", report.degradations)):
        if lines:
            more = [f"- and {len(lines) - MAX_NOTES} more"] if len(lines) > MAX_NOTES else []
            parts += [f"## {title}", "\n".join([*(f"- {_code(line)}" for line in lines[:MAX_NOTES]), *more])]
    stages = _slowest(runs)
    if stages:
        parts += ["## Slowest stages", _grid(("stage", "scenes", "total s", "median s", "longest s", "longest scene"), stages)]
    parts += ["## Next", "\n".join(f"- {line}" for line in _next(report, lake))]
    return "\n\n".join(parts) + "\n"


def _next(report: RunReport, lake: str) -> list[str]:
    """What the reader can do now."""
    steps = []
    if report.failures:
        steps.append("Mend what each failure names and run again: changed scans are computed by themselves.")
        steps.append("`--retry-failed` (parameter `retry_failed`) computes unchanged ones again; lost workers are retried anyway.")
    if report.postponed:
        steps.append("Run it again for what was postponed; nothing that is done is repeated.")
    steps.append(f"How the lake stands: `metascenes status --lake {lake}`")
    if report.done:
        steps.append(f"Take scenes out: `metascenes export --lake {lake} --out replicas`")
        steps.append(f"Draw the statistics: `metascenes stats --lake {lake} --artifacts`, or the deployment of the flow `statistics`.")
    return steps


def _slowest(runs: Mapping[tuple[str, str], StageRun]) -> list[tuple[str, ...]]:
    """Stages by the time that they took in all."""
    stages: dict[str, list[tuple[float, str]]] = {}
    for (scene_id, stage), run in runs.items():
        stages.setdefault(stage, []).append((run.seconds, scene_id))
    rows: list[tuple[str, ...]] = []
    for stage, times in sorted(stages.items(), key=lambda item: -sum(seconds for seconds, _ in item[1])):
        seconds = [value for value, _ in times]
        longest = max(times)
        figures = (f"{sum(seconds):.1f}", f"{statistics.median(seconds):.2f}", f"{longest[0]:.2f}")
        rows.append((stage, f"{len(times):,}", *figures, _code(longest[1])))
    return rows


def runs_of(report: RunReport, plan: Plan, lake: Lake) -> dict[tuple[str, str], StageRun]:
    """The executions of this run by (scene, stage), as `stage_runs` has them."""
    computed = {*report.done, *report.failed}
    wanted = {(s.scan.scene_id, step.stage): step.fingerprint.value for s in plan.todo if s.scan.scene_id in computed for step in s.todo}
    history = lake.history({scene for scene, _ in wanted}) if wanted else {}
    return {
        key: history[key].last for key, fingerprint in wanted.items() if key in history and history[key].last.fingerprint == fingerprint
    }


def formats_of(lake: Lake, scenes: Sequence[str]) -> dict[str, str]:
    """Formats that the lake can give each of some scenes in."""
    if not scenes or not lake.exists:
        return {}
    by_scene: dict[str, set[str]] = {}
    # Without SQL: its views read the footers of all tables first, which takes seconds where they lie in a store.
    for row in lake.snapshot().matching("export_files", {"scene_id": set(scenes)}, ["scene_id", "format"]).to_pylist():
        by_scene.setdefault(row["scene_id"], set()).add(row["format"])
    return {scene: ", ".join(sorted(formats)) for scene, formats in by_scene.items()}


def _failure_of(report: RunReport) -> dict[str, tuple[str, str]]:
    """Stage and reason of every failed scene, from the report's lines `<scene>: <stage>: <reason>`."""
    failed, failures = set(report.failed), {}
    for line in (*report.known, *report.failures):
        scene, _, rest = line.partition(": ")
        if scene in failed:
            stage, _, why = rest.partition(": ")
            failures[scene] = (stage, why)
    return failures


def todo(plan: Plan) -> str:
    """What there is to do, in a line."""
    counts = plan.counts()
    parts = [f"{len(plan.todo)} of {counted(len(plan.scenes), 'scene')} to do", f"{counted(counts['run'], 'stage run')}"]
    if counts["report"]:
        parts.append(f"{counts['report']} failed before on unchanged input")
    if plan.unusable:
        parts.append(f"{counted(len(plan.unusable), 'scan')} cannot be used")
    return ", ".join(parts)


def counts(report: RunReport) -> str:
    """What came of it, in a line."""
    failed = [line for line in report.failures if line not in report.broken]
    named = {"done": report.done, "failed": failed, "failed checks": report.broken, "up to date": report.unchanged, "shared": report.shared}
    return ", ".join(
        f"{len(scenes)} {name}" for name, scenes in (named | {"postponed": report.postponed}).items() if scenes or name == "done"
    )


def _grid(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows))


def _code(text: str) -> str:
    """Text that Markdown leaves as it is."""
    return f"`{' '.join(text.split()).replace('`', chr(39))}`"
