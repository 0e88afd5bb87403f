"""What is in sight where agents end: whoever says that something was found must have it in view."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from schemas.capture import Instance, Shell
from schemas.optimization import Placement
from tasks.evaluation.configuration import EvaluationConfig
from tasks.simulation.cameras import camera_poses

AT_ONCE = 64
"""Pictures that are drawn together: some megabytes."""


@dataclasses.dataclass(frozen=True)
class SceneSights:
    """Rows of one scene that say what stands where, and the blobs that they name."""

    shell: Shell | None
    placements: tuple[Placement, ...]
    instances: tuple[Instance, ...]
    assets: tuple[Asset, ...]
    blobs: Mapping[str, bytes]

    def seen(self, ends: Sequence[tuple[str, Sequence[float]]], config: EvaluationConfig) -> list[bool | None]:
        """Whether each target, by instance, is in the picture from where its agent ended, x, y [m] and yaw [rad], world frame; None of
        targets that were not placed.

        Raises:
            InputError: the scene cannot be drawn.
        """
        from tasks.simulation.rasterizer import Rasterizer
        from tasks.simulation.scenery import scenery

        placed = {placement.instance_id for placement in self.placements}
        wanted = [index for index, (target, _) in enumerate(ends) if target in placed]
        verdicts: list[bool | None] = [None] * len(ends)
        if not wanted:
            return verdicts
        scene = scenery(self.shell, (), self.placements, self.assets, self.instances, self.blobs)
        camera, owners = Rasterizer(scene.soup), np.array([*scene.instance_ids, None], dtype=object)
        for first in range(0, len(wanted), AT_ONCE):
            some = wanted[first : first + AT_ONCE]
            poses = camera_poses([ends[index][1] for index in some], config.camera_height_m)
            parts = camera.render(poses, config.camera_px, config.camera_px, config.camera_hfov).part
            for index, part in zip(some, parts, strict=True):
                verdicts[index] = _share(part, owners == ends[index][0]) >= config.seen_share
        return verdicts


def _share(part: NDArray[np.int32], is_target: NDArray[np.bool_]) -> float:
    """Share of a picture that shows the target: `is_target` of each part, and of nothing last."""
    return float(is_target[part].mean())
