"""What one Prefect task computes: a few scenes, one after another, in whichever process the task runs in."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from flows.run.configuration import Configuration
from flows.run.fanout.pools import pool_of
from flows.run.ledger import FREE, CallRules
from flows.run.plan import ScenePlan
from flows.run.scene import STAGE_SECONDS, Around, SceneResult, SceneWork, one_process
from warehouse.lake import Lake


class SceneBatch:
    """Scenes for one task. It goes to the task as it is: Prefect looks into dataclasses, and Dask takes them apart.

    Tried again in the same process, it goes on where it was: what is finished stays finished.
    """

    def __init__(
        self,
        run: str,
        lake: Lake,
        scenes: Sequence[ScenePlan],
        configuration: Configuration,
        *,
        processes: Callable[[], int] = one_process,
        shows_stages: bool = False,
        limits: Mapping[str, str] | None = None,
        timeout: float = STAGE_SECONDS,
        calls: CallRules = FREE,
    ) -> None:
        self.run, self.lake, self.configuration = run, lake, configuration
        self.scenes = tuple(scenes)
        self.shows_stages = shows_stages
        self.limits = dict(limits or {})
        self.processes = processes
        """What a stage that begins now may use."""
        self._works = [SceneWork(scene, processes, timeout, calls) for scene in scenes]

    @property
    def name(self) -> str:
        """The scenes, in a few words."""
        first = self.scenes[0].scan.scene_id
        return first if len(self.scenes) == 1 else f"{first} and {len(self.scenes) - 1} more"

    def compute(self, around: Around | None = None) -> list[SceneResult]:
        """Try what is not finished; results of all scenes, in order."""
        pool = pool_of(self.run)
        for work in self._works:
            if not work.is_finished:
                work.advance(self.lake, self.configuration, pool, around)
        return [work.result for work in self._works if work.result is not None]
