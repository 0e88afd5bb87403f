"""What a run did, as a value that a scheduler can read."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from flows.plan import Plan
from flows.scene import SceneResult


@dataclasses.dataclass(frozen=True)
class RunReport:
    """Scenes computed, failed and left as they were, and one line per failure."""

    done: tuple[str, ...]
    failed: tuple[str, ...]
    unchanged: tuple[str, ...]
    failures: tuple[str, ...]
    steps: int
    degradations: tuple[str, ...]


def report_of(plan: Plan, results: Sequence[SceneResult]) -> RunReport:
    """The report of a plan that was carried out with these results."""
    computed = {result.scene_id for result in results}
    failed = {r.scene_id for r in results if r.failed} | {s.scan.scene_id for s in plan.scenes if s.failure}
    failures = [f"{r.scene_id}: {r.failed}: {r.error}" for r in sorted(results, key=lambda r: r.scene_id) if r.failed]
    return RunReport(
        done=tuple(sorted(r.scene_id for r in results if not r.failed)),
        failed=tuple(sorted(failed)),
        unchanged=tuple(s.scan.scene_id for s in plan.scenes if s.scan.scene_id not in computed and not s.failure),
        failures=(*plan.failures, *failures),
        steps=sum(len(r.ran) for r in results),
        degradations=tuple(text for r in sorted(results, key=lambda r: r.scene_id) for text in r.degradations),
    )
