"""A lineage as text: an indented tree, the stage runs behind it, and what does not hold."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Sequence

from schemas.lineage import Lineage, RunFacts
from tasks.lineage.words import UNRECORDED, described, moment

Settings = Callable[[RunFacts], Sequence[str] | None]
"""What a run was told otherwise than by default; None when that is not known."""

_HASH = 12
"""Digits of a fingerprint that are shown; the JSON form has all."""


def outline(lineage: Lineage, settings: Settings, width: int = 120) -> str:
    """The walk as a tree, `width` characters wide, with a newline at its end."""
    snapshot = lineage.snapshot
    released = f", released as {', '.join(lineage.releases)}" if lineage.releases else ""
    lines = [f"snapshot {snapshot.snapshot_id} of {moment(snapshot.created_at.isoformat())}{released}", "", *_tree(lineage, width)]
    lines += ["", "stage runs"]
    for run in sorted(lineage.runs.values(), key=lambda run: (run.started_at, run.id), reverse=True):
        lines += _run_lines(run, settings, _concerned(lineage), width)
    if not lineage.runs:
        lines.append(f"  {UNRECORDED}")
    lines.append("")
    if lineage.problems:
        lines.append(f"{len(lineage.problems)} statement{'s do' if len(lineage.problems) > 1 else ' does'} not hold")
        lines += [_wrapped(f"  {problem.kind}: {problem.text}", "    ", width) for problem in lineage.problems]
    else:
        lines.append(f"every id leads to a row: {len(lineage.nodes)} nodes, {len(lineage.edges)} links")
    return "\n".join(lines) + "\n"


def _tree(lineage: Lineage, width: int) -> list[str]:
    lines: list[str] = []
    shown: set[str] = set()
    rows = lineage.outline
    for index, (depth, role, node_id) in enumerate(rows):
        node = lineage.nodes[node_id]
        trunk = "".join("│  " if _goes_on(rows, index, level) else "   " for level in range(1, depth))
        is_last = not _goes_on(rows, index, depth)
        branch = "" if not depth else "└─ " if is_last else "├─ "
        below = trunk + ("" if not depth else "   " if is_last else "│  ")
        below += "│  " if index + 1 < len(rows) and rows[index + 1][0] > depth else "   "
        texts = described(node)
        if node_id in shown and depth:
            texts = [f"{texts[0]} (above)"]
        shown.add(node_id)
        head = f"{role}: {texts[0]}" if role else texts[0]
        run = lineage.runs.get(node.run or "")
        head += f"  [{run.stage}]" if run is not None else ""
        lines.append(_wrapped(trunk + branch + head, below, width))
        lines += [_wrapped(below + text, below + "  ", width) for text in texts[1:]]
    return lines


def _goes_on(rows: Sequence[tuple[int, str, str]], index: int, level: int) -> bool:
    """Whether another branch leaves the same node at a level below a line of the outline."""
    for depth, _, _ in rows[index + 1 :]:
        if depth <= level:
            return depth == level
    return False


def _run_lines(run: RunFacts, settings: Settings, concerned: set[str], width: int) -> list[str]:
    committed = f"snapshot {run.snapshot_id}" + (f" of {moment(run.committed_at)}" if run.committed_at else ", which has expired")
    seed = UNRECORDED if run.seed is None else str(run.seed)
    differing = settings(run)
    changed = "of a type that this version does not have" if differing is None else ", ".join(differing) or "all by default"
    read = [f"{name} {value[:_HASH] or 'none'}" for name, value in (*run.inputs.items(), *run.upstream.items())]
    texts = [
        f"{moment(run.started_at)}, {run.seconds:.2f} s on {run.host}, attempt {run.attempt}, committed in {committed}",
        f"fingerprint {run.fingerprint[:_HASH]}, code {_short(run.code)}, config {_short(run.config_hash)}, seed {seed}",
        f"read {', '.join(read) or UNRECORDED}",
        f"settings: {changed}",
        *(f"left out or done otherwise: {text}" for text in run.degradations if _concerns(text, concerned)),
    ]
    lines = [f"  {run.stage} of {run.scene_id}"]
    return lines + [_wrapped(f"    {text}", "      ", width) for text in texts]


def _concerned(lineage: Lineage) -> set[str]:
    """Instances that the lineage is about; none where it is about whole scenes."""
    kind = lineage.nodes[lineage.target].kind
    return {node.key.rpartition("/")[2] for node in lineage.of_kind("instance")} if kind in ("instance", "export") else set()


def _concerns(degradation: str, instances: set[str]) -> bool:
    """Whether a degradation is about one of these instances, or about none in particular."""
    named = re.match(r"([0-9]{4,})\b", degradation)
    return not instances or named is None or named[1] in instances


def _short(value: str | None) -> str:
    return value[:_HASH] if value else UNRECORDED


def _wrapped(text: str, below: str, width: int) -> str:
    """Text over as many lines as it takes, the later ones after `below`."""
    lead = re.match(r"[│├└─ ]*", text)
    head = lead[0] if lead else ""
    lines = textwrap.wrap(
        text[len(head) :], width, initial_indent=head, subsequent_indent=below, break_long_words=False, break_on_hyphens=False
    )
    return "\n".join(lines) if lines else text
