"""Films: what the agent sees is the simulator's picture, it stands where its pose says, and every pose is a frame."""

from __future__ import annotations

import dataclasses
import io
import itertools
import math
from functools import cache

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from PIL import Image

from schemas.capture import Shell
from schemas.evaluation import ACTIONS, Trajectory
from schemas.navigation import Episode
from tasks.films.first_person import AT_ONCE, first_person
from tasks.films.frames import OUTCOMES, depth_picture, frame, frames, moments, stills, view_place
from tasks.films.reel import webp
from tasks.films.robots import robot
from tasks.films.rooms import INNER_M, FilmedRoom, filmed_room
from tasks.films.third_person import RING_M, TARGET, TRACK, ThirdPerson
from tasks.films.walks import STRIP_LOOK, FilmedWalk, FilmLook
from tasks.policy.model.config import AgentCamera
from tasks.shell import room_shell
from tasks.simulation import protocol
from tasks.simulation.configuration import SimulationConfig
from tasks.simulation.simulator import WorldSimulator
from tasks.simulation.world import World, world_of
from tasks.stats.scenes import PictureConfig, RoomOutline
from tests.samples import sample
from tests.tasks.simulation.acted_scenes import STUDY, acted_scene

LOOK = FilmLook(room=PictureConfig(width=320, height=240, oversampling=1, elevation_radians=0.95), view_px=64, text_px=9)
CAMERA = AgentCamera(width=64, height=64)
RADIUS, HEIGHT = 0.18, 0.88
Poses = list[tuple[float, float, float]]


def walk_of(poses: Poses, instance: str = "0001", is_success: bool = True, actions: tuple[str, ...] | None = None) -> FilmedWalk:
    done = actions or ("forward",) * (len(poses) - 1)
    trajectory = sample(
        Trajectory, scene_id="demo/room_00", episode_id="0007", policy="expert", run_name="built-in", instance_id=instance, category="desk",
        actions=done, poses=tuple(poses), called_stop=done[-1:] == ("stop",), final_distance_m=0.1, is_target_seen=True,
    )  # fmt: skip
    return FilmedWalk(trajectory, is_success, RADIUS, HEIGHT, CAMERA)


def empty_room(**objects: list[trimesh.Trimesh]) -> FilmedRoom:
    """5 by 4 m, white, nothing in it but the objects."""
    ring = ((0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0))
    shell = sample(Shell, floor_polygon=ring, height_m=2.5, openings=(), interior_walls=(), slopes=(), floor_color=(230, 230, 230),
                   wall_color=(230, 230, 230))  # fmt: skip
    return FilmedRoom([part for _, part in room_shell(shell)], objects, RoomOutline.of_room(shell))


def box(size: tuple[float, float, float], at: tuple[float, float, float], color: tuple[int, int, int] = (120, 120, 120)) -> trimesh.Trimesh:
    made = trimesh.creation.box(size)
    made.apply_translation(at)
    made.visual.vertex_colors = np.tile([*color, 255], (len(made.vertices), 1))
    return made


@cache
def study() -> tuple[World, Episode]:
    made = acted_scene(STUDY)
    rows = made.rows
    world = world_of(STUDY, rows["shells"][0], (), rows["placements"], rows["assets"], rows["instances"], rows["navmeshes"][0],
                     made.episodes, made.blobs, 0.05)  # fmt: skip
    return world, max(made.episodes, key=lambda episode: (len(episode.actions), episode.episode_id))


def acted(actions: tuple[str, ...]) -> tuple[Poses, list[protocol.AgentView]]:
    """Poses and observations of the simulator."""
    world, episode = study()
    simulator = WorldSimulator(lambda _: world, SimulationConfig(width=CAMERA.width, height=CAMERA.height))
    names = {protocol.STOP: "stop", protocol.FORWARD: "forward", protocol.LEFT: "left", protocol.RIGHT: "right"}
    states, views = [simulator.reset(episode)], [simulator.render()]
    for action in actions:
        states.append(simulator.step([names[number] for number in protocol.ACTIONS].index(action)))
        views.append(simulator.render())
    return [(state.x, state.y, state.yaw) for state in states], views


def test_what_the_agent_sees_is_the_simulators_picture_to_the_last_bit() -> None:
    world, episode = study()
    actions = (*episode.actions, *("left", "forward", "right", "right") * 10)
    assert set(actions) == set(ACTIONS)
    poses, observed = acted(actions)
    assert len(poses) > AT_ONCE + 1
    filmed = list(first_person(world, poses, CAMERA))
    assert len(filmed) == len(observed) == len(actions) + 1
    for mine, theirs in zip(filmed, observed, strict=True):
        np.testing.assert_array_equal(mine.rgb, theirs.rgb)
        np.testing.assert_array_equal(mine.depth, theirs.depth)
        np.testing.assert_array_equal(mine.semantic, theirs.semantic)
    assert len({view.rgb.tobytes() for view in filmed}) > 5
    walk = walk_of(poses, episode.instance_id, actions=actions)
    third = ThirdPerson(empty_room(), walk, LOOK.room)
    left, top = view_place(LOOK)
    for step in (0, 3, len(poses) - 1):
        shown = frame(third, filmed[step], walk, step, LOOK)
        np.testing.assert_array_equal(shown[top : top + 64, left : left + 64], observed[step].rgb)


def pixel(image: NDArray[np.uint8], third: ThirdPerson, point: tuple[float, float, float]) -> NDArray[np.int64]:
    column, row = third.place(point)
    return image[round(row), round(column)].astype(np.int64)


LARGE = dataclasses.replace(LOOK.room, width=960, height=720)


@pytest.mark.whole
def test_the_agent_stands_where_its_pose_says_and_looks_where_it_is_heading() -> None:
    fans = 0
    for x, y in ((1.2, 1.1), (3.9, 2.9)):
        for yaw in (0.0, 1.2, math.pi, -2.2):
            third = ThirdPerson(empty_room(), walk_of([(x, y, yaw)]), LARGE)
            outline = silhouette(third, x, y, yaw)
            bare = np.full((720, 960, 3), 128, dtype=np.float32)
            third._draw_agent(bare, x, y, yaw)
            drawn = np.abs(bare - 128).max(axis=2) > 4
            assert (drawn & outline).sum() > 0.92 * (drawn | outline).sum(), "but for pixels that it covers in part"
            middles = [np.mean(np.nonzero(mask), axis=1) for mask in (drawn, outline)]
            assert np.hypot(*(middles[0] - middles[1])) < 0.5
            image = third.picture(0)
            turn = np.array([math.cos(yaw), math.sin(yaw)])
            ahead, behind = (np.array([x, y]) + side * 0.40 * RADIUS * turn for side in (1, -1))
            assert pixel(image, third, (*ahead, HEIGHT)).min() > 190, "the arrow on its top points ahead"
            assert pixel(image, third, (*behind, HEIGHT))[0] < 150
            looked, unseen = (np.array([x, y]) + side * 0.55 * turn for side in (1, -1))
            places = [third.place((*point, 0.0)) for point in (looked, unseen)]
            if not any(outline[round(row), round(column)] for column, row in places):
                before, after = (pixel(image, third, (*point, 0.0)) for point in (looked, unseen))
                assert before[2] - before[0] > after[2] - after[0] + 25, "what it looks at is blue"
                fans += 1
    assert fans >= 4


def silhouette(third: ThirdPerson, x: float, y: float, yaw: float) -> NDArray[np.bool_]:
    """Pixels within the convex hull of a robot's corners, shape (h, w)."""
    import shapely

    corners = np.concatenate([part.vertices for part in robot(RADIUS, HEIGHT)])
    cosine, sine = math.cos(yaw), math.sin(yaw)
    turned = corners @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]) + [x, y, 0.0]
    hull = shapely.MultiPoint([third.place(tuple(corner)) for corner in turned]).convex_hull
    column, row = np.meshgrid(np.arange(third.camera.width), np.arange(third.camera.height))
    return np.asarray(shapely.contains_xy(hull, column, row))


def test_the_way_so_far_is_on_the_floor_and_the_rest_is_not() -> None:
    poses = [(0.8 + 0.4 * step, 1.0, 0.0) for step in range(8)]
    third = ThirdPerson(empty_room(), walk_of(poses), LARGE)
    before, after = third.picture(0), third.picture(7)
    for first, second in itertools.pairwise(poses[1:6]):
        middle = ((first[0] + second[0]) / 2, 1.0, 0.0)
        assert np.abs(pixel(after, third, middle) - TRACK).max() < 12
    late = ((poses[5][0] + poses[6][0]) / 2, 1.0, 0.0)
    assert np.abs(pixel(before, third, late) - TRACK).max() > 60, "not walked yet"
    assert pixel(before, third, late).min() > 150
    np.testing.assert_array_equal(third.picture(3), ThirdPerson(empty_room(), walk_of(poses), LARGE).picture(3))  # back again
    start = pixel(after, third, (0.8 - RING_M + 0.015, 1.0, 0.0))
    assert start.max() < 120, "a dark ring where it began"


def test_what_hides_the_agent_lets_it_shine_through() -> None:
    poses = [(2.5, 2.0, 0.0)]
    hidden = ThirdPerson(empty_room(**{"0002": [box((0.9, 0.9, 1.4), (2.5, 2.0, 0.7))]}), walk_of(poses), LARGE)
    image, alone = hidden.picture(0), pixel(hidden._ground, hidden, (2.5, 2.0, 0.2 * HEIGHT))
    through = pixel(image, hidden, (2.5, 2.0, 0.2 * HEIGHT))
    free = ThirdPerson(empty_room(), walk_of(poses), LARGE)
    seen = pixel(free.picture(0), free, (2.5, 2.0, 0.2 * HEIGHT))
    assert through[2] - through[0] > 20 > abs(alone[2] - alone[0]), "it is there"
    assert through[2] - through[0] < 0.85 * (seen[2] - seen[0]), "and fainter than in the open"


def test_the_target_is_outlined_wherever_it_stands_and_nothing_else_is() -> None:
    desk, other = [box((0.8, 0.5, 0.7), (3.5, 3.0, 0.35))], [box((0.8, 0.5, 0.7), (1.2, 3.0, 0.35))]
    poses = [(1.0, 1.0, 0.0)]
    third = ThirdPerson(empty_room(**{"0001": desk, "0002": other}), walk_of(poses), LOOK.room)
    assert third.target_box is not None
    left, top, right, bottom = third.target_box
    corners = np.array([third.place(tuple(corner)) for corner in desk[0].vertices])
    assert np.abs([left, top] - corners.min(axis=0)).max() < 2
    assert np.abs([right, bottom] - corners.max(axis=0)).max() < 2
    image = third.picture(0).astype(np.int64)
    rows, columns = np.nonzero(np.abs(image - TARGET).max(axis=2) < 40)
    assert len(rows) > 40
    assert (columns.min() > left - 5) & (columns.max() < right + 5) & (rows.min() > top - 5) & (rows.max() < bottom + 5)
    nowhere = ThirdPerson(empty_room(**{"0002": other}), walk_of(poses), LOOK.room)
    assert nowhere.target_box is None
    assert not (np.abs(nowhere.picture(0).astype(np.int64) - TARGET).max(axis=2) < 60).any()


def test_a_target_on_a_wall_that_is_cut_away_stays() -> None:
    """Pictures hang on all four walls; two of them are always between the camera and the room."""
    hung = {"0001": [box((0.05, 0.6, 0.5), (0.03, 2.0, 1.5))], "0002": [box((0.05, 0.6, 0.5), (4.97, 2.0, 1.5))],
            "0003": [box((0.6, 0.05, 0.5), (2.5, 0.03, 1.5))], "0004": [box((0.6, 0.05, 0.5), (2.5, 3.97, 1.5))]}  # fmt: skip
    for name in hung:
        assert ThirdPerson(empty_room(**hung), walk_of([(1.0, 1.0, 0.0)], name), LOOK.room).target_box is not None


def test_interior_walls_are_cut_low() -> None:
    shell = sample(
        Shell, floor_polygon=((0.0, 0.0), (5.0, 0.0), (5.0, 4.0), (0.0, 4.0)), height_m=2.5, openings=(), slopes=(),
        interior_walls=((2.5, 0.0, 2.5, 4.0, 0.1, 2.5),),
    )  # fmt: skip
    room = filmed_room(shell, (), (), (), {})
    inner = [part for part in room.walls if part.bounds[0, 0] > 0.1 and part.bounds[1, 0] < 4.9 and part.bounds[0, 2] > -0.01
             and np.ptp(part.bounds[:, 0]) < 0.2]  # fmt: skip
    assert [part.bounds[1, 2] for part in inner] == [INNER_M]
    assert max(part.bounds[1, 2] for part in room.walls) == 2.5


def test_a_robot_is_as_large_as_its_agent_and_stands_on_the_floor() -> None:
    bounds = np.array([part.bounds for part in robot(RADIUS, HEIGHT)])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    assert low[2] == 0
    assert high[2] == pytest.approx(HEIGHT, rel=0.01)
    assert np.abs([low[:2], high[:2]]).max() == pytest.approx(RADIUS, rel=0.01)


def filmed(count: int, is_success: bool = True) -> tuple[ThirdPerson, list[protocol.AgentView], FilmedWalk]:
    turns = ("left",) * (count - 2) + ("stop",)
    poses, views = acted(turns)
    walk = walk_of(poses, study()[1].instance_id, is_success, turns)
    return ThirdPerson(empty_room(**{walk.trajectory.instance_id: [box((0.5, 0.5, 0.5), (4.0, 3.0, 0.25))]}), walk, LOOK.room), views, walk


def test_every_pose_is_a_frame_and_the_same_walk_gives_the_same_bytes() -> None:
    third, views, walk = filmed(9)
    shots = list(frames(third, views, walk, LOOK))
    assert len(shots) == len(walk.poses) == 9
    data = webp(iter(shots), 9, LOOK)
    with Image.open(io.BytesIO(data)) as film:
        assert (film.format, film.n_frames, film.size) == ("WEBP", 9, shots[0].shape[1::-1])  # type: ignore[attr-defined]
        for step, shot in enumerate(shots):
            film.seek(step)
            assert np.abs(np.asarray(film.convert("RGB")).astype(int) - shot).mean() < 4
            assert film.info["duration"] == (LOOK.rest_ms if step in (0, 8) else LOOK.step_ms)
    again, views, walk = filmed(9)
    assert webp(frames(again, iter(views), walk, LOOK), 9, LOOK) == data


def test_a_walk_without_an_action_is_a_film_too() -> None:
    world, _ = study()
    x, y, yaw = acted(())[0][0]
    walk = dataclasses.replace(walk_of([(x, y, yaw)], actions=()), is_success=False)
    assert walk.ending == "never stopped in 0 actions"
    shots = list(frames(ThirdPerson(empty_room(), walk, LOOK.room), first_person(world, walk.poses, CAMERA), walk, LOOK))
    with Image.open(io.BytesIO(webp(shots, 1, LOOK))) as film:
        assert film.size == shots[0].shape[1::-1]


@pytest.mark.parametrize("is_success", [True, False])
def test_the_caption_says_how_it_ended(is_success: bool) -> None:
    third, views, walk = filmed(4, is_success)
    shot = frame(third, views[1], walk, 1, LOOK)
    colors = {name: int((np.abs(shot[LOOK.room.height :].astype(int) - color).max(axis=2) < 8).sum()) for name, color in OUTCOMES.items()}
    assert colors[walk.outcome] > 100
    assert colors["failure" if is_success else "success"] == 0
    assert walk.act(0) == "start"
    assert walk.act(3) == "step 3 of 3: stop"
    done = walk.trajectory
    assert walk.ending == "stopped 0.10 m from a view point, target in view"
    lost = dataclasses.replace(walk, trajectory=dataclasses.replace(done, final_distance_m=None))
    assert lost.ending == "stopped where no path leads to a view point"
    cut = dataclasses.replace(walk, trajectory=dataclasses.replace(done, called_stop=False))
    assert cut.ending == "never stopped in 3 actions"


def test_depth_is_lighter_the_nearer_and_the_target_has_a_line() -> None:
    depth = np.array([[0.0] * 9, [0.5] * 9, [2.0] * 9, [4.0] * 9, [9.0] * 9], dtype=np.float32).repeat(3, axis=0)
    semantic = np.full(depth.shape, protocol.NO_OBJECT, dtype=np.int32)
    view = protocol.AgentView(np.zeros((*depth.shape, 3), np.uint8), depth, semantic)
    plain = depth_picture(view, 3, 5.0).astype(int).sum(axis=2)
    assert (np.diff(plain[4::3, 0]) < 0).all()
    assert plain[14, 0] == depth_picture(dataclasses.replace(view, depth=np.minimum(depth, 5.0)), 3, 5.0).astype(int).sum(axis=2)[14, 0]
    semantic[6:9, 3:6] = 3
    is_line = (depth_picture(view, 3, 5.0) == TARGET).all(axis=2)
    assert is_line[5, 4]
    assert is_line[7, 2]
    assert not is_line[7, 4]
    assert not is_line[0].any()


def test_stills_begin_with_the_first_pose_and_end_with_the_last() -> None:
    assert moments(12, 4) == [0, 4, 7, 11]
    assert moments(2, 4) == [0, 1]
    assert moments(1, 4) == [0]
    third, views, walk = filmed(9)
    strip = stills(third, views, walk, LOOK)
    first, last = views[0].rgb, views[8].rgb
    left = 3 * (LOOK.room.width + 8)
    np.testing.assert_array_equal(strip[-64:, :64], first)
    np.testing.assert_array_equal(strip[-64:, left : left + 64], last)
    assert STRIP_LOOK.room.elevation_radians == FilmLook().room.elevation_radians
