"""What the page is told of carts that drove through a scene."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

from schemas.robot import RobotRun
from warehouse.questions.views import asked_by
from warehouse.tables.snapshot import Reader

MOST_DRIVES = 48
"""Runs that a page holds: 10 kB each."""


def drives_of(reader: Reader, scene_id: str) -> list[dict[str, Any]]:
    """Runs of carts that count and went anywhere: of each policy, setup and body as many as a page holds, the first episodes of each."""
    ranked: dict[tuple[str, ...], list[RobotRun]] = defaultdict(list)
    for row in sorted(_counted(reader, scene_id), key=lambda row: row.episode_id):
        if len(row.track) > 1:
            ranked[row.policy, row.run_name, row.setup, row.body].append(row)
    share = max(1, MOST_DRIVES // max(len(ranked), 1))
    return [_drive(row) for _, some in sorted(ranked.items()) for row in some[:share]][:MOST_DRIVES]


def _counted(reader: Reader, scene_id: str) -> list[RobotRun]:
    """The newest run of each way."""
    rows = reader.rows(RobotRun, scene_id)
    if not rows:
        return []
    asked = "SELECT batch_id, episode_id FROM current_robot_runs WHERE scene_id = ?"
    with reader.connect(names=asked_by(asked)) as connection:
        current = set(connection.execute(asked, [scene_id]).fetchall())
    return [row for row in rows if (row.batch_id, row.episode_id) in current]


def _drive(row: RobotRun) -> dict[str, Any]:
    def rounded(poses: Sequence[Sequence[float]]) -> list[list[float]]:
        return [[round(value, 4) for value in pose] for pose in poses]

    return {
        "id": f"{row.batch_id} {row.episode_id}", "episode": row.episode_id, "target": row.instance_id, "category": row.category,
        "policy": row.policy, "run": row.run_name, "setup": row.setup, "body": row.body, "outcome": row.outcome, "radius": row.radius_m,
        "seconds": row.seconds, "error": row.error_m, "subgoals": rounded(row.subgoals), "track": rounded(row.track),
        "estimate": rounded(row.estimate),
    }  # fmt: skip
