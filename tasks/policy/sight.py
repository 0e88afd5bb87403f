"""What an agent sees: pictures of scenes by the rows that say how these look."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from tasks.policy.collection import VisibleScene
from tasks.policy.demonstrations import Array
from tasks.policy.model.config import PolicyModel
from tasks.policy.senses import codes_of, sensed
from tasks.simulation.cameras import camera_poses

KEPT = 2
"""Scenes that are ready to be rendered: walks come a scene at a time."""


class SceneRenderer:
    """A `tasks.policy.store.Render`. looks: Rows of scenes. assets: By id. blobs: That the rows name."""

    def __init__(
        self, looks: Mapping[str, VisibleScene], assets: Mapping[str, Asset], blobs: Mapping[str, bytes], model: PolicyModel
    ) -> None:
        self._looks, self._assets, self._blobs, self._model = looks, assets, blobs, model
        self._ready: OrderedDict[str, Any] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_ready": OrderedDict()}

    def __call__(self, scene_id: str, poses: Array) -> NDArray[np.uint8]:
        """Pictures of a scene from poses x, y [m] and yaw [rad], shape (n, 3), to (n, h, w, c) as `tasks.policy.senses` has them."""
        camera, (rasterizer, codes) = self._model.camera, self._of(scene_id)
        views = camera_poses(poses, camera.height_m, math.radians(camera.pitch_degrees))
        return sensed(rasterizer.render(views, camera.width, camera.height, camera.hfov_radians), codes, self._model)

    def _of(self, scene_id: str) -> Any:
        """What renders a scene, and the codes of its parts."""
        if scene_id in self._ready:
            self._ready.move_to_end(scene_id)
            return self._ready[scene_id]
        from tasks.simulation.rasterizer import Rasterizer
        from tasks.simulation.scenery import scenery

        rows = self._looks[scene_id]
        assets = [self._assets[asset_id] for asset_id in sorted({placement.asset_id for placement in rows.placements})]
        visible = scenery(rows.shell, rows.surfaces, rows.placements, assets, rows.instances, self._blobs)
        made = Rasterizer(visible.soup), codes_of(visible.things(rows.instances))
        self._ready[scene_id] = made
        while len(self._ready) > KEPT:
            self._ready.popitem(last=False)
        return made
