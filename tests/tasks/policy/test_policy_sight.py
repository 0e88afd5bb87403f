"""Pictures of scenes by their rows: what the rasterizer draws from where an agent is."""

from __future__ import annotations

import math
import pickle

import numpy as np

from tasks.policy.model.config import AgentCamera, OwnEyes, SmallPolicy
from tasks.policy.sight import KEPT, SceneRenderer
from tasks.simulation.cameras import camera_poses
from tasks.simulation.rasterizer import Rasterizer
from tasks.simulation.scenery import scenery
from tests.tasks.policy.rooms import dataset, navigated, walks


def test_agents_see_their_scenes_from_where_they_are() -> None:
    data, camera = walks(rooms=4), AgentCamera(32, 24, pitch_degrees=-10.0)
    model = SmallPolicy(camera=camera, eyes=OwnEyes(patch=8))
    _, blobs = dataset(rooms=4)
    sight = SceneRenderer(data.looks, data.assets, blobs, model)
    poses = data.train[0].poses
    pictures = sight("demo/room_00", poses)
    assert (pictures.shape, pictures.dtype) == ((len(poses), 24, 32, 3), np.uint8)
    rows = navigated()[0]
    made = Rasterizer(scenery(rows["shells"][0], (), rows["placements"], rows["assets"], rows["instances"], blobs).soup)
    views = camera_poses(poses, camera.height_m, math.radians(camera.pitch_degrees))
    assert np.array_equal(pictures, made.render(views, 32, 24, camera.hfov_radians).rgb)
    assert len({picture.tobytes() for picture in pictures}) > 2
    again = pickle.loads(pickle.dumps(sight))
    assert np.array_equal(again("demo/room_00", poses[:2]), pictures[:2])
    for name in sorted(data.looks):
        assert np.array_equal(sight(name, poses[:1])[0], pictures[0]), "all rooms look alike here"
    assert len(sight._ready) == KEPT
