"""A walk through the rows of one snapshot: reads scene by scene, follows ids, and notes those that lead nowhere."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from datetime import datetime
from functools import cached_property
from typing import Any, TypeVar

from schemas.lineage import Edge, Lineage, Node, Place, Problem, RunFacts
from schemas.parsing import json_value
from schemas.record import table_of
from schemas.runs import StageRun
from warehouse.tables.gate import BatchState, batch_states
from warehouse.tables.history import StageState, states
from warehouse.tables.snapshot import Reader

R = TypeVar("R")

ReadPlaces = Callable[[str, str, bytes], Sequence[Place]]
"""What a scene's exported file says of its objects, from format, path and contents."""

_OWN_PARTS = ("config", "code", "seed")
"""Parts of a fingerprint that are neither outside inputs nor stages."""


class Walk:
    """A graph in the making. `blobs` are the lake's; `read_places` reads exported scenes; `earlier` is a walk through the same
    snapshot, whose rows need not be read again."""

    def __init__(self, reader: Reader, blobs: Mapping[str, bytes], read_places: ReadPlaces, earlier: Walk | None = None) -> None:
        self.reader, self.blobs, self.read_places = reader, blobs, read_places
        self._read: dict[tuple[str, str], list[Any]] = earlier._read if earlier is not None else {}
        self._nodes: dict[str, Node] = {}
        self._edges: dict[Edge, None] = {}
        self._runs: dict[str, RunFacts] = {}
        self._problems: dict[Problem, None] = {}
        self._outline: list[tuple[int, str, str]] = []
        self._states: dict[str, dict[str, StageState]] = {}
        self._rows: dict[tuple[str, str], list[Any]] = {}
        self._stage_runs: dict[tuple[str, str], str | None] = {}

    @cached_property
    def returned(self) -> frozenset[str]:
        """Annotation batches that are back with their annotators."""
        return frozenset(name for name, state in self._batches.items() if state.state == "returned")

    @cached_property
    def counting(self) -> frozenset[str]:
        """Annotation batches whose answers reach scenes."""
        return frozenset(name for name, state in self._batches.items() if state.counts)

    @cached_property
    def _batches(self) -> dict[str, BatchState]:
        return batch_states(self.reader)

    def rows(self, record_type: type[R], scene_id: str) -> list[R]:
        """Rows of a scene, sorted by key. That they are as many as their stage's run wrote is checked when they are first read."""
        table = table_of(record_type)
        rows = self._rows.get((table.name, scene_id))
        if rows is None:
            rows = self._read.get((table.name, scene_id))
            if rows is None:
                rows = self._read[table.name, scene_id] = list(self.reader.rows(record_type, scene_id))
            self._rows[table.name, scene_id] = rows
            if table.grain == "scene":
                self._check_count(table.name, table.stage, scene_id, len(rows))
        return rows

    def row(self, record_type: type[R], scene_id: str, **values: Any) -> R | None:
        """The first row of a scene with these values; None when there is none."""
        return next((row for row in self.rows(record_type, scene_id) if all(getattr(row, n) == v for n, v in values.items())), None)

    def state(self, scene_id: str, stage: str) -> StageState | None:
        """What was run of a stage on a scene or batch; None when nothing was."""
        if scene_id not in self._states:
            by_stage = states(self.reader.arrow("stage_runs", scene_id))
            self._states[scene_id] = {name: state for (_, name), state in by_stage.items()}
        return self._states[scene_id].get(stage)

    def stages(self, scene_id: str) -> list[str]:
        """Stages of which rows are in the lake, by start of their runs."""
        self.state(scene_id, "")
        done = [state.done for state in self._states[scene_id].values() if state.done is not None]
        return [run.stage for run in sorted(done, key=lambda run: (run.started_at, run.stage))]

    def run(self, scene_id: str, stage: str) -> str | None:
        """Id of the run whose rows of a stage are in the lake; None when none is recorded. Its upstream is checked."""
        if (scene_id, stage) not in self._stage_runs:
            state = self.state(scene_id, stage)
            done = state.done if state is not None else None
            self._stage_runs[scene_id, stage] = self._add_run(done) if done is not None else None
            if state is not None and done is None:
                self.problem("incomplete", f"{scene_id}/{stage}", f"rows of {stage} are there, but its run was {state.last.outcome}")
        return self._stage_runs[scene_id, stage]

    def facts_of_run(self, scene_id: str, stage: str) -> RunFacts | None:
        """The same run's facts."""
        return self._runs.get(self.run(scene_id, stage) or "")

    def node(self, kind: str, key: str, facts: Mapping[str, Any], run: str | None = None) -> str:
        """Add a node, once; its id."""
        node = Node(kind, key, {name: plain(value) for name, value in facts.items()}, run)
        if node.id not in self._nodes or self._nodes[node.id].is_missing:
            self._nodes[node.id] = node
        return node.id

    def has(self, node_id: str) -> bool:
        """Whether there is such a node."""
        return node_id in self._nodes

    def edge(self, source: str, target: str, role: str) -> None:
        """Say that `source` was made from, names or describes `target`."""
        self._edges[Edge(source, target, role)] = None

    def missing(self, source: str, kind: str, key: str, role: str) -> str:
        """Note that `source` names something that is not there; the id of a node that stands for it."""
        node = Node(kind, key, {}, None, is_missing=True)
        self._nodes.setdefault(node.id, node)
        self.edge(source, node.id, role)
        self.problem("missing", source, f"{kind} {key} is named, but not there")
        return node.id

    def problem(self, kind: str, at: str, text: str) -> None:
        """Note what does not hold at a node or run."""
        self._problems[Problem(kind, at, text)] = None

    def line(self, depth: int, role: str, node_id: str) -> None:
        """Add a line to the outline."""
        self._outline.append((depth, role, node_id))

    def leads(self, depth: int, source: str, target: str, role: str) -> None:
        """An edge from `source` to `target`, and the line of the outline that shows it."""
        self.edge(source, target, role)
        self.line(depth, role, target)

    def check_blobs(self, node_id: str, names: Iterable[str | None]) -> None:
        """Follow the names of blobs to the lake's files."""
        for name in names:
            if name is not None and name not in self.blobs:
                self.missing(node_id, "blob", name, "kept in")

    def lineage(self, target: str) -> Lineage:
        """The finished graph.

        Raises:
            LookupError: the lake has no snapshot.
        """
        if self.reader.snapshot is None:
            raise LookupError("the lake has no snapshot yet")
        return Lineage(
            target=target,
            snapshot=self.reader.snapshot,
            releases=tuple(r.name for r in self.reader.releases if r.snapshot_id == self.reader.snapshot_id),
            nodes=self._nodes,
            edges=tuple(self._edges),
            runs=self._runs,
            problems=tuple(self._problems),
            outline=tuple(self._outline),
        )

    def _add_run(self, run: StageRun) -> str:
        name = f"{run.scene_id}/{run.stage}/{run.fingerprint[:12]}/{run.attempt}"
        parts, above = _pairs(run.reasons), _pairs(run.upstream)
        committed = next((s.created_at for s in self.reader.snapshots if s.snapshot_id == run.snapshot_id), None)
        self._runs[name] = RunFacts(
            id=name,
            scene_id=run.scene_id,
            stage=run.stage,
            fingerprint=run.fingerprint,
            attempt=run.attempt,
            outcome=run.outcome,
            started_at=run.started_at.isoformat(),
            seconds=run.seconds,
            host=run.host,
            code=parts.get("code"),
            config_hash=parts.get("config"),
            config=_config(run.config),
            seed=int(parts["seed"]) if parts.get("seed", "").lstrip("-").isdigit() else None,
            inputs={part: value for part, value in parts.items() if part not in _OWN_PARTS and part not in above},
            upstream=above,
            snapshot_id=run.snapshot_id,
            committed_at=committed.isoformat() if committed is not None else None,
            degradations=run.degradations,
        )
        for stage, fingerprint in above.items():
            state = self.state(run.scene_id, stage)
            if state is None or state.done is None:
                text = f"{run.stage} of {run.scene_id} read {stage} {fingerprint[:12]}, of which no rows are there"
                self.problem("missing", name, text)
            elif state.done.fingerprint != fingerprint:
                now = state.done.fingerprint[:12]
                self.problem("stale", name, f"{run.stage} of {run.scene_id} read {stage} {fingerprint[:12]}, which is {now} now")
        return name

    def _check_count(self, table: str, stage: str, scene_id: str, count: int) -> None:
        """A table holds what its stage's run says that it wrote."""
        state = self.state(scene_id, stage)
        wrote = _pairs(state.done.row_counts).get(table, "") if state is not None and state.done is not None else ""
        if wrote.isdigit() and int(wrote) != count:
            run = self.run(scene_id, stage) or f"{scene_id}/{stage}"
            self.problem("incomplete", run, f"{table} of {scene_id} has {count} rows, and its run wrote {wrote}")


def picked(row: Any, *names: str) -> dict[str, Any]:
    """Columns of a row by name."""
    return {name: getattr(row, name) for name in names}


def position(pose: Sequence[float] | None) -> list[float] | None:
    """Where a 4x4 pose, row by row, puts the origin [m]."""
    return None if pose is None else [pose[3], pose[7], pose[11]]


def plain(value: Any) -> Any:
    """A value as JSON has it."""
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def lost(values: Iterable[str], among: Container[str]) -> list[str]:
    """The distinct values that are not `among` these, sorted."""
    return sorted({value for value in values if value not in among})


def _pairs(entries: Iterable[str]) -> dict[str, str]:
    return dict(entry.split("=", 1) for entry in entries if "=" in entry)


def _config(text: str) -> Any:
    """A config as JSON values; text that is no JSON stays text."""
    try:
        return json_value(text)
    except ValueError:
        return text
