"""What an agent senses beside colors: depth, and the pixels of what it is sent to, as the rasterizer knows them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tasks.policy.augmentation import PictureAugmentation, drawn, looked
from tasks.policy.model.config import AgentCamera, OwnEyes, SmallPolicy
from tasks.policy.model.presets import PRESETS
from tasks.policy.senses import FAR_M, channels_of, codes_of, meant, sensed
from tasks.policy.sight import SceneRenderer
from tasks.simulation.cameras import camera_poses
from tasks.simulation.rasterizer import Pictures, Rasterizer
from tasks.simulation.scenery import scenery
from tests.tasks.policy.rooms import dataset, navigated, walks

SENSING = SmallPolicy(camera=AgentCamera(32, 32), eyes=OwnEyes(patch=8, depth=True, goal=True))


def test_what_is_sensed_is_what_the_cameras_of_the_simulator_say() -> None:
    data = walks(rooms=2)
    _, blobs = dataset(rooms=2)
    rows = navigated()[0]
    visible = scenery(rows["shells"][0], (), rows["placements"], rows["assets"], rows["instances"], blobs)
    walk = data.train[0]
    camera = SENSING.camera
    views = camera_poses(walk.poses, camera.height_m, math.radians(camera.pitch_degrees))
    truth = Rasterizer(visible.soup).render(views, 32, 32, camera.hfov_radians)
    seen = SceneRenderer(data.looks, data.assets, blobs, SENSING)(walk.scene_id, walk.poses)
    assert seen.shape == (len(walk), 32, 32, 7)
    assert np.array_equal(seen[..., :3], truth.rgb)
    near = (truth.part >= 0) & (truth.depth < FAR_M)
    assert np.abs(seen[..., 3] * FAR_M / 255 - truth.depth)[near].max() <= 0.51 * FAR_M / 255
    categories = np.array([*visible.things(rows["instances"]), ""])
    assert {"floor"} <= {*visible.categories} - {*categories.tolist()}, "what is no object is nothing to go to"
    for goal in {*categories.tolist()} - {""}:
        marked = meant(seen, goal, SENSING)
        assert marked.shape == (len(walk), 32, 32, 5)
        assert np.array_equal(marked[..., -1] == 255, categories[truth.part] == goal)
        assert {*np.unique(marked[..., -1])} <= {0, 255}
    assert not meant(seen, "no such thing", SENSING)[..., -1].any()
    assert not meant(seen, "floor", SENSING)[..., -1].any()
    assert (meant(seen, walk.category, SENSING)[..., -1] == 255).any(), "the target comes into view on its walk"


def test_nothing_is_far_away_and_of_no_category() -> None:
    room = Pictures.empty(1, 32, 32)
    room.rgb[:], room.depth[:], room.part[:] = 0, 0.0, -1
    seen = sensed(room, codes_of(["chair"]), SENSING)
    assert (seen[..., 3] == 255).all()
    assert not meant(seen, "chair", SENSING)[..., -1].any()


@pytest.mark.parametrize(
    ("model", "rendered", "taken"),
    [
        (PRESETS["small"], 3, 3), (PRESETS["sensing"], 7, 5), (PRESETS["blind"], 3, 3), (PRESETS["goalless"], 4, 4),
        (PRESETS["paper"], 3, 3),
        (dataclasses.replace(SENSING, goalless=True), 4, 4), (dataclasses.replace(SENSING, blind=True), 3, 3),
    ],
)  # fmt: skip
def test_a_policy_takes_what_it_senses(model: SmallPolicy, rendered: int, taken: int) -> None:
    assert (channels_of(model), model.channels) == (rendered, taken)
    pictures = np.zeros((2, 4, 4, rendered), dtype=np.uint8)
    assert meant(pictures, "chair", model).shape[-1] == taken


def test_categories_have_codes_of_their_own_and_nothing_has_none() -> None:
    from tasks.furniture import CATEGORIES

    codes = codes_of(CATEGORIES)
    assert len({tuple(code) for code in codes.tolist()}) == len(CATEGORIES) + 1
    assert codes[-1].tolist() == [0, 0, 0]


def test_what_is_sensed_is_cut_out_with_the_colors() -> None:
    """A white square on black, sensed as the goal: after a change it is still where the picture is white."""
    pictures = np.zeros((3, 32, 32, 5), dtype=np.uint8)
    pictures[:, 8:20, 11:25] = 255
    config = PictureAugmentation(brightness=0, contrast=0, saturation=0, hue=0, crop=0.6, blur_share=0, sharpen_share=0, posterize_share=0)
    rng = np.random.default_rng(3)
    moved = 0
    for _ in range(20):
        change = drawn(config, rng)
        made = looked(pictures, change)
        assert made.shape == pictures.shape
        assert np.array_equal(made[..., 3], made[..., 4])
        for axis in (1, 2):  # seen from above and from the side: at corners colors are mixed by both
            assert np.array_equal((made[..., 4] == 255).any(axis=axis), (made[..., 1] > 127).any(axis=axis))
        moved += not np.array_equal(made[..., 4], pictures[..., 4])
    assert moved > 15
