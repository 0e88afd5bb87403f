"""Episodes: from a random start to a random object along a shortest path (supplementary B.3)."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tasks.navigation.configuration import NavigationConfig
from tasks.navigation.follower import follow, replay
from tasks.navigation.protocol import DistanceField, Path, PathFinder
from tasks.navigation.targets import NavigationTarget

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Route:
    """A start, the shortest path from it to the nearest view point of a target, and actions that follow it.

    start: World frame [m], shape (2,). yaw: Heading at the start [rad]. final: Where the actions end, shape (2,).
    final_distance: Geodesic distance from there to the goal [m].
    """

    target: NavigationTarget
    start: Array
    yaw: float
    path: Path
    actions: tuple[str, ...]
    final: Array
    final_distance: float


class RouteSampler:
    """Draws routes to one target. Its limit on the geodesic distance is halved when no start is far enough away."""

    def __init__(self, target: NavigationTarget, finder: PathFinder, config: NavigationConfig) -> None:
        self.target, self.least_m, self.rejected = target, config.min_geodesic_m, Counter[str]()
        self._finder, self._config = finder, config
        self._fields: dict[int, DistanceField] = {}
        self._islands = np.unique(target.islands)
        areas = np.array([finder.islands[i] for i in self._islands])
        self._shares = areas / areas.sum()

    @cached_property
    def _nearest(self) -> DistanceField:
        """Distances to the nearest view point: only of targets that are drawn, for it looks at the whole floor."""
        return self._finder.field(self.target.view_points)

    def draw(self, rng: np.random.Generator) -> Route | None:
        """A route; None when neither the limit nor any of its halves left one."""
        config = self._config
        while True:
            for _ in range(config.start_tries):
                outcome = self._try(rng)
                if isinstance(outcome, Route):
                    return outcome
                self.rejected[outcome] += 1
            if self.least_m <= config.shortest_geodesic_m:
                return None
            self.least_m = max(self.least_m / 2, config.shortest_geodesic_m)

    def _try(self, rng: np.random.Generator) -> Route | str:
        """A route from one random start, uniform over the floor that is connected to a view point, or why there is none."""
        config, finder = self._config, self._finder
        island = int(rng.choice(self._islands, p=self._shares))
        start, yaw = finder.random_point(rng, island), float(rng.uniform(-np.pi, np.pi))
        nearest = self._nearest.path(start)
        if not nearest.exists:
            return "without a path"
        if nearest.length < self.least_m:
            return "too near"
        goal = nearest.goal
        if goal not in self._fields:
            self._fields[goal] = finder.field(self.target.view_points[goal])
        field = self._fields[goal]
        actions = follow(start, yaw, field, finder, config.motion, config.stop_m, config.max_steps, config.search_expansions)
        if actions is None:
            return "without actions that get there"
        trajectory = replay(actions, start, yaw, finder, config.motion)
        final = trajectory.poses[-1, :2]
        left = float(field.distances(final)[0])
        if trajectory.collisions or left > config.success_m:
            return "with actions that fail in replay"
        if trajectory.length > config.max_path_ratio * nearest.length:
            return "with a detour"
        return Route(self.target, start, yaw, nearest, tuple(actions), final, left)


def sample_routes(
    targets: Sequence[NavigationTarget], count: int, finder: PathFinder, config: NavigationConfig, rng: np.random.Generator
) -> tuple[list[Route], dict[str, str], list[str]]:
    """Routes to targets in random order, every target once before any comes again.

    Returns:
        The routes; why a target has none, by instance; and limits that had to be halved, one line each.
    """
    every = samplers = [RouteSampler(target, finder, config) for target in targets]
    routes: list[Route] = []
    failed: dict[str, str] = {}
    while samplers and len(routes) < count:
        for index in rng.permutation(len(samplers)):
            if len(routes) == count:
                break
            route = samplers[index].draw(rng)
            if route is not None:
                routes.append(route)
            else:
                failed[samplers[index].target.instance_id] = _reason(samplers[index])
        samplers = [sampler for sampler in samplers if sampler.target.instance_id not in failed]
    served = {route.target.instance_id for route in routes}
    relaxed = [
        f"{s.target.instance_id}: few starts are {config.min_geodesic_m:g} m away, so episodes from {s.least_m:g} m were taken"
        for s in every
        if s.least_m < config.min_geodesic_m and s.target.instance_id in served
    ]
    return routes, {instance: reason for instance, reason in failed.items() if instance not in served}, relaxed


def _reason(sampler: RouteSampler) -> str:
    counts = ", ".join(f"{number} {what}" for what, number in sorted(sampler.rejected.items()))
    return f"none of {sampler.rejected.total()} random starts could be used: {counts}"
