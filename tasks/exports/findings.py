"""What a check found."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

from schemas.exports import ExportCheck


@dataclasses.dataclass(frozen=True, order=True)
class Finding:
    """A rule that is broken: which, where (file, prim, episode) and how. A warning does not fail an export.

    A file may give its parts names as long as it likes; they are cut.
    """

    rule: str
    where: str
    message: str
    is_error: bool = True

    def __post_init__(self) -> None:
        for name, most in (("where", 200), ("message", 1000)):
            text = getattr(self, name)
            object.__setattr__(self, name, text if len(text) <= most else f"{text[: most - 3]}...")

    def __str__(self) -> str:
        return f"{self.rule}: {self.where}: {self.message}"


def verdicts(scene_id: str, format_: str, rules: Iterable[str], findings: Sequence[Finding]) -> list[ExportCheck]:
    """One row per rule: passed, or the first few things that are wrong."""
    rows = []
    for rule in sorted(set(rules) | {finding.rule for finding in findings if finding.is_error}):
        broken = [f"{finding.where}: {finding.message}" for finding in findings if finding.rule == rule and finding.is_error]
        more = f" (and {len(broken) - 3} more)" if len(broken) > 3 else ""
        message = "; ".join(broken[:3]) + more if broken else None
        rows.append(ExportCheck(scene_id=scene_id, format=format_, rule=rule, passed=not broken, message=message))
    return rows
