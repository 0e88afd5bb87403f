"""What a check found."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

from schemas.exports import ExportCheck
from schemas.text import cut


@dataclasses.dataclass(frozen=True, order=True)
class Finding:
    """A rule that is broken: which, where (file, prim, episode) and how. A warning does not fail an export.

    A file may give its parts names as long as it likes; they are cut where they are shown.
    """

    rule: str
    where: str
    message: str
    is_error: bool = True

    def __str__(self) -> str:
        return f"{self.rule}: {self.broken}"

    @property
    def broken(self) -> str:
        """Where, and how, as it is shown."""
        return f"{cut(self.where, 200)}: {cut(self.message, 1000)}"


def verdicts(scene_id: str, format_: str, rules: Iterable[str], findings: Sequence[Finding]) -> list[ExportCheck]:
    """One row per rule: passed, or the first few faults."""
    rows = []
    for rule in sorted(set(rules) | {finding.rule for finding in findings if finding.is_error}):
        broken = [finding.broken for finding in findings if finding.rule == rule and finding.is_error]
        more = f" (and {len(broken) - 3} more)" if len(broken) > 3 else ""
        message = "; ".join(broken[:3]) + more if broken else None
        rows.append(ExportCheck(scene_id=scene_id, format=format_, rule=rule, passed=not broken, message=message))
    return rows
