"""Scenes that wait for a worker. A scene is claimed before it is computed, so that several runs share the work."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from datetime import UTC, datetime

from flows.run.fanout.committer import Committer
from flows.run.plan import Plan, ScenePlan
from warehouse.lake import Lake
from warehouse.sharing.claims import Claims

LOOK_SECONDS = (0.5, 5.0)
"""How long a scene that another run computes is left alone: at first, and at most."""

Replan = Callable[[ScenePlan, bool], ScenePlan | None]
"""The plan of a scene as the lake is now, told whether failed steps are computed again; None when its scan cannot be read."""


class Backlog:
    """The scenes of a run that have something to compute, in order.

    What another run has computed since the plan was made is not computed again: `shared` names those scenes, and
    `failures` says what the other run failed at.
    """

    def __init__(self, lake: Lake, plan: Plan, claims: Claims, committer: Committer, replan: Replan, retry_failed: bool) -> None:
        self._lake, self._claims, self._committer, self._replan = lake, claims, committer, replan
        self._waiting = deque(plan.todo)
        self._others: deque[tuple[float, ScenePlan]] = deque()
        self._pause = LOOK_SECONDS[0]
        self._retry_failed = retry_failed
        self._began = datetime.now(UTC)
        self._seen = plan.snapshot_id
        self._stamp: str | None = None
        self._foreign: set[int] = set()
        self.shared: list[str] = []
        self.failures: dict[str, str] = {}
        self.over: list[str] = []
        """Those of both that nobody has counted yet."""

    def __len__(self) -> int:
        return len(self._waiting) + len(self._others)

    @property
    def pause(self) -> float | None:
        """Seconds until a scene that another run has is worth another look; None when there is none."""
        return max(0.05, self._others[0][0] - time.monotonic()) if self._others else None

    def take(self, count: int) -> list[ScenePlan]:
        """Up to so many scenes, claimed, with what is left to compute of them. Fewer, when other runs have the rest."""
        now = time.monotonic()
        while self._others and self._others[0][0] <= now:
            self._waiting.appendleft(self._others.popleft()[1])
        taken: list[ScenePlan] = []
        while self._waiting and len(taken) < count:
            scene = self._waiting.popleft()
            if not self._claims.claim(scene.scan.scene_id):
                self._others.append((now + self._pause, scene))
                self._pause = min(self._pause * 1.2, LOOK_SECONDS[1])
                continue
            current = self._current(scene)
            if current is None:
                self._claims.release(scene.scan.scene_id)
            else:
                taken.append(current)
        return taken

    def give_back(self, scene: ScenePlan) -> None:
        """A scene whose worker did not come back waits again."""
        self._claims.release(scene.scan.scene_id)
        self._waiting.append(scene)

    def finished(self, scene_id: str) -> None:
        """A scene's rows are staged, or it failed: it may be anybody's again."""
        self._claims.release(scene_id)

    def left(self) -> list[ScenePlan]:
        """Scenes that were not taken."""
        return [*self._waiting, *(scene for _, scene in self._others)]

    def _current(self, scene: ScenePlan) -> ScenePlan | None:
        """What is left to compute of a claimed scene; None when another run has done it, well or not."""
        if not self._is_touched(scene.scan.scene_id):
            return scene
        planned = self._replan(scene, self._retry_failed)
        if planned is not None and self._retry_failed and any(self._failed_since(step.before) for step in planned.todo):
            planned = self._replan(scene, False)
        if planned is None:
            return scene  # computing it says what is wrong with its scan
        if planned.todo:
            return planned
        if planned.failure is not None and planned.failure.before is not None:
            self.failures[scene.scan.scene_id] = f"{planned.failure.stage}: {planned.failure.before.error}"
        else:
            self.shared.append(scene.scan.scene_id)
        self.over.append(scene.scan.scene_id)
        return None

    def _failed_since(self, before: object) -> bool:
        return getattr(before, "outcome", "") == "failed" and getattr(before, "started_at", self._began) > self._began

    def _is_touched(self, scene_id: str) -> bool:
        """Whether another run may have computed something of a scene since the plan was made.

        As long as nobody else commits, two listings say so; a plan costs much more than they do. What is staged first: a
        commit removes that after its snapshot is there.
        """
        if self._lake.has_staged(scene_id):
            return True
        stamp = self._lake.last_commit()
        if stamp != self._stamp or self._foreign:
            newest = self._lake.snapshot().snapshot_id if stamp != self._stamp else self._seen
            self._foreign |= set(range(self._seen + 1, newest + 1))
            self._foreign -= set(self._committer.snapshots)
            self._stamp, self._seen = stamp, newest
        return bool(self._foreign)
