"""A lineage: what something in the lake was made from, as a graph of rows and of the stage runs that wrote them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

from schemas.runs import Snapshot

FORMAT = 1
"""Version of the JSON form."""

PROBLEMS = ("missing", "stale", "incomplete", "differs")
"""What can be wrong: an id that leads to no row or file; a run that read older rows than those of today; a table with
other rows than its run wrote; two places that should say the same and do not."""


@dataclasses.dataclass(frozen=True)
class Node:
    """A row, a group of rows, or a file.

    `facts` are plain JSON values by name, None where the lake records nothing. `run` is the id of the stage run that wrote
    it, None where none is recorded. `is_missing` marks what is named somewhere but is not there.
    """

    kind: str
    key: str
    facts: Mapping[str, Any]
    run: str | None = None
    is_missing: bool = False

    @property
    def id(self) -> str:
        """`<kind>:<key>`, unique in the graph."""
        return f"{self.kind}:{self.key}"


@dataclasses.dataclass(frozen=True)
class Edge:
    """`source` was made from, names or describes `target`, as `role` says: both are ids of nodes."""

    source: str
    target: str
    role: str


@dataclasses.dataclass(frozen=True)
class RunFacts:
    """A stage run. `code`, `config_hash` and `seed` are parts of its fingerprint, None where it has no such part; `config` is
    the config's JSON value. `committed_at` is None when its snapshot has expired since."""

    id: str
    scene_id: str
    stage: str
    fingerprint: str
    attempt: int
    outcome: str
    started_at: str
    seconds: float
    host: str
    code: str | None
    config_hash: str | None
    config: Any
    seed: int | None
    inputs: Mapping[str, str]
    upstream: Mapping[str, str]
    snapshot_id: int
    committed_at: str | None
    degradations: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Problem:
    """Something that does not hold. `at` is the id of the node or the stage run that it was found at."""

    kind: str
    at: str
    text: str


@dataclasses.dataclass(frozen=True)
class Lineage:
    """All that is known of `target` (the id of a node) in one snapshot; `releases` are those of that snapshot.

    `outline` is the walk from the target as lines of a tree: depth, role, id of a node.
    """

    target: str
    snapshot: Snapshot
    releases: tuple[str, ...]
    nodes: Mapping[str, Node]
    edges: tuple[Edge, ...]
    runs: Mapping[str, RunFacts]
    problems: tuple[Problem, ...]
    outline: tuple[tuple[int, str, str], ...]

    def document(self) -> dict[str, Any]:
        """The graph as plain JSON values, as `schemas/lineage/lineage.schema.json` describes them."""
        return {
            "format": FORMAT,
            "target": self.target,
            "snapshot": {
                "snapshot_id": self.snapshot.snapshot_id,
                "created_at": self.snapshot.created_at.isoformat(),
                "note": self.snapshot.note,
                "releases": list(self.releases),
            },
            "nodes": [
                {
                    "id": node.id,
                    "kind": node.kind,
                    "key": node.key,
                    "is_missing": node.is_missing,
                    "run": node.run,
                    "facts": dict(node.facts),
                }
                for node in self.nodes.values()
            ],
            "edges": [dataclasses.asdict(edge) for edge in self.edges],
            "runs": [{**dataclasses.asdict(run), "degradations": list(run.degradations)} for run in self.runs.values()],
            "problems": [dataclasses.asdict(problem) for problem in self.problems],
        }

    def of_kind(self, kind: str) -> Iterator[Node]:
        """Nodes of a kind, in the order of the walk."""
        return (node for node in self.nodes.values() if node.kind == kind)


@dataclasses.dataclass(frozen=True)
class Place:
    """An object as an exported file has it: its name there (in USD its prim path) and the rows that it says it is from."""

    name: str
    scene_id: str | None
    instance_id: str
    asset_id: str | None
