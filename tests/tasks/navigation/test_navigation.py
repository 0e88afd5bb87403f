"""The navigation stage: navmesh, episodes, unreachable targets and splits of a scene."""

from __future__ import annotations

import dataclasses
import hashlib
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from scipy.spatial import cKDTree

from schemas.candidates import Asset
from schemas.capture import Instance, Scene, Shell
from schemas.errors import InputError
from schemas.optimization import Placement
from schemas.record import rows_to_arrow
from schemas.tables import TABLES
from tasks.geometry.meshes import canonical, dump_glb, load_glb, sample_surface
from tasks.geometry.transforms import flat, yaw_pose
from tasks.navigation import STAGE, NavigationConfig, placed_surfaces, run, split_of
from tasks.navigation.configuration import Agent, PathFinderConfig
from tasks.navigation.follower import STOP, replay
from tasks.navigation.navmesh import polygon_areas, polygon_islands, read_navmesh
from tasks.navigation.obstacles import footprint, free_space
from tasks.navigation.plan import draw_plan
from tasks.navigation.planar import PlanarConfig, PlanarPathFinder
from tasks.navigation.recast import LIBRARY, RecastConfig
from tasks.stage import Blobs, Context, Outcome
from tests.tasks.navigation.test_shortest_paths import ROOM_SIZE, brute_force, solid, surface

native = pytest.mark.skipif(
    not LIBRARY.is_file(), reason="the library of the path finder recast is not built: install librecast-dev, run make native"
)

SCENE = "demo/room_00"
CONFIG = NavigationConfig(train_episodes=14, test_episodes=14)


def furnished(
    objects: dict[str, tuple[str, list[trimesh.Trimesh], tuple[float, float, float], float]], size: tuple[float, float] = ROOM_SIZE
) -> tuple[dict, Context]:
    """Input rows of a room with objects: instance to category, parts, position and yaw."""
    blobs, instances, placements, assets = Blobs(), [], [], {}
    for instance_id, (category, parts, at, yaw) in objects.items():
        data = dump_glb(parts)
        asset_id, pose = hashlib.sha256(data).hexdigest(), flat(yaw_pose(yaw, at))
        extents = tuple(map(float, np.ptp(surface(*parts).bounds, axis=0)))
        assets[asset_id] = Asset(
            asset_id=asset_id, provider="test", name=category, category=category, source="test", license="CC0-1.0", author=None,
            mesh_blob=blobs.add(data, "glb"), pieces_blob=None, extents=extents, volume_m3=1.0, is_watertight=True,
            vertex_count=8, face_count=12, open_reason=None, has_texture=False, source_url=None, thumbnail_blob=None,
        )  # fmt: skip
        instances.append(Instance(
            scene_id=SCENE, instance_id=instance_id, source_id=instance_id, raw_label=category, category=category, nyu40_id=0,
            nyu40_label="unlabeled", is_structure=False, found_by=None, category_probability=None,
            room_index=None, box_pose=pose, box_size=extents, box_volume_m3=1.0,
            hidden_m=None, point_count=9, points_blob="0" * 64 + ".ply", mesh_blob=None, view_blob=None, best_frames=(),
        ))  # fmt: skip
        placements.append(Placement(
            scene_id=SCENE, instance_id=instance_id, asset_id=asset_id, origin="selection", annotator=None, annotation_match=None,
            scale=(1.0, 1.0, 1.0), proposed_pose=pose, optimized_pose=pose, displacement_m=0.0, lift_m=0.0, method="default",
            settled_pose=None, remains=None,
            collider_pieces=None, collider_faces=None, collider_early_share=None, collider_miss_share=None,
            collider_blob=None, collider_cut_share=None, collider_distance_m=None, fidelity_loss=None,
        ))  # fmt: skip
    scene = Scene(
        scene_id=SCENE, room_id="demo/room", dataset="demo", scan="room_00", scan_format="scannet", scan_path="room_00",
        alignment=flat(np.eye(4)), alignment_source="file", to_original=flat(np.eye(4)),
        floor_tilt_radians=0.0, mesh_blob="0" * 64 + ".glb", vertex_count=3, face_count=1, frame_count=0,
        instance_count=len(instances), segmentation="file", license=None,
    )  # fmt: skip
    w, d = size
    room = Shell(
        scene_id=SCENE, room_type="office", floor_polygon=((0.0, 0.0), (w, 0.0), (w, d), (0.0, d)), floor_area_m2=w * d,
        floor_source="surface", walls=(), interior_walls=(), openings=None, slopes=None, lintels=None,
        height_m=2.6, height_source="ceiling",
        floor_color=None, wall_color=None,
    )  # fmt: skip
    tables = {"scenes": [scene], "placements": placements, "shells": [room], "instances": instances, "assets": list(assets.values())}
    return tables, Context(SCENE, "navigation", 3, blobs)


def living_room() -> tuple[dict, Context]:
    top, legs = solid((1.2, 0.8, 0.05), (0, 0, 0.7)), [solid((0.05, 0.05, 0.7), (x, y, 0)) for x in (-0.5, 0.5) for y in (-0.3, 0.3)]
    return furnished({
        "0001": ("table", [top, *legs], (2.2, 2.0, 0.0), 0.4),
        "0002": ("chair", [solid((0.45, 0.45, 0.45)), solid((0.05, 0.45, 0.5), (-0.2, 0, 0.45))], (2.4, 1.1, 0.0), 1.2),
        "0003": ("wardrobe", [solid((1.0, 0.5, 2.0))], (4.4, 3.6, 0.0), 0.0),
        "0004": ("mug", [solid((0.1, 0.1, 0.12))], (2.1, 2.1, 0.75), 0.0),
        "0005": ("rug", [solid((1.5, 1.0, 0.02))], (4.0, 1.5, 0.0), 0.0),
        "0006": ("stage", [solid((2.6, 2.6, 0.5))], (-1.7, -1.7, 0.0), 0.0),  # mostly beyond the wall
        "0007": ("vase", [solid((0.1, 0.1, 0.3))], (-1.7, -1.7, 0.5), 0.0),
    })  # fmt: skip


@pytest.mark.whole
def test_episodes_hold_in_replay_and_their_paths_are_shortest() -> None:
    tables, context = living_room()
    outcome = run(**tables, context=context, config=CONFIG)
    for name, rows in outcome.rows.items():
        assert rows_to_arrow(rows, TABLES[name].record).num_rows == len(rows)
    episodes, agent = outcome.rows["episodes"], CONFIG.agent
    assert len(episodes) == 14
    assert {e.instance_id for e in episodes} == {"0001", "0002", "0003", "0004", "0005", "0006"}
    placed = placed_surfaces(tables["placements"], tables["assets"], context.blobs)
    blocked = [footprint(s, agent.max_climb_m, agent.height_m) for s in placed.values()]
    finder = PlanarPathFinder(free_space(tables["shells"][0].floor_polygon, blocked, agent.radius_m, 0.0625))
    grown = shapely.buffer(finder.free, 1e-6)
    for e in episodes:
        assert e.instruction == f"Navigate to the {e.category}"
        assert e.actions[-1] == STOP
        assert STOP not in e.actions[:-1]
        assert len(e.actions) <= CONFIG.max_steps
        done = replay(e.actions, e.start_position[:2], e.start_yaw_radians, finder, CONFIG.motion)
        assert done.collisions == 0
        assert grown.covers(shapely.LineString(done.poses[:, :2]))
        assert done.poses[-1, :2] == pytest.approx(e.final_position[:2], abs=1e-12)
        assert math.dist(e.final_position, e.goal_position) <= e.final_distance_m + 1e-9 <= CONFIG.success_m
        assert done.length <= CONFIG.max_path_ratio * e.geodesic_m
        assert e.geodesic_m >= max(CONFIG.shortest_geodesic_m, e.euclidean_m - 1e-9)
        views = np.array(e.view_points)
        outline = shapely.MultiPoint(placed[e.instance_id].vertices[:, :2]).convex_hull
        assert shapely.distance(outline, shapely.points(views[:, :2])).max() <= CONFIG.view_reach_m + 1e-9
        assert finder.is_navigable(views[:, :2]).all()
        ahead = shapely.get_coordinates(outline.centroid)[0] - views[:, :2]
        assert np.allclose(ahead, np.hypot(*ahead.T)[:, None] * np.stack([np.cos(views[:, 3]), np.sin(views[:, 3])], axis=1), atol=1e-9)
        start = np.array(e.start_position[:2])
        expected = brute_force(finder.free, np.array([start, *views[:, :2]]))[0, 1:]
        assert e.geodesic_m == pytest.approx(expected.min(), abs=1e-6)
        assert tuple(views[expected.argmin(), :2]) == e.goal_position[:2]
    assert [u.instance_id for u in outcome.rows["unreachable_targets"]] == ["0007"]
    assert "m away" in outcome.rows["unreachable_targets"][0].reason


def test_the_navmesh_row_tells_what_its_file_holds() -> None:
    tables, context = living_room()
    outcome = run(**tables, context=context, config=dataclasses.replace(CONFIG, train_episodes=1, test_episodes=1))
    (row,) = outcome.rows["navmeshes"]
    navmesh = read_navmesh(outcome.blobs[row.navmesh_blob])
    (tile,) = navmesh.tiles
    areas, islands = polygon_areas(tile), polygon_islands(tile)
    assert areas.sum() == pytest.approx(row.area_m2, abs=1e-3)
    assert islands.max() + 1 == row.island_count
    assert max(areas[islands == i].sum() for i in range(row.island_count)) == pytest.approx(row.largest_island_m2, abs=1e-3)
    assert navmesh.settings is not None
    assert (navmesh.settings.agent_radius, navmesh.settings.agent_height) == pytest.approx((row.agent_radius_m, row.agent_height_m))
    # The start of an episode lies on the navmesh in Habitat's frame: x, up, -y.
    x, y, _ = outcome.rows["episodes"][0].start_position
    rings = [shapely.Polygon(tile.vertices[p["vertices"][: p["count"]]][:, [0, 2]]) for p in tile.polygons]
    assert any(ring.buffer(1e-5).contains(shapely.Point(x, -y)) for ring in rings)


def test_the_same_rows_in_any_order_give_the_same_bytes() -> None:
    def digest(outcome: Outcome) -> list[object]:
        tables = [rows_to_arrow(rows, TABLES[name].record) for name, rows in outcome.rows.items()]
        return [sorted(outcome.blobs), outcome.degradations, *tables]

    tables, context = living_room()
    config = dataclasses.replace(CONFIG, train_episodes=7, test_episodes=7)
    first = digest(run(**tables, context=context, config=config))
    assert digest(run(**{name: rows[::-1] for name, rows in tables.items()}, context=context, config=config)) == first
    other = dataclasses.replace(context, seed=4)
    assert digest(run(**tables, context=other, config=config)) != first


def test_small_rooms_get_shorter_episodes_and_say_so() -> None:
    tables, context = furnished({"0001": ("box", [solid((0.6, 0.6, 0.6))], (0.9, 0.9, 0.0), 0.0)}, size=(1.8, 1.8))
    outcome = run(**tables, context=context, config=dataclasses.replace(CONFIG, view_directions=4))
    lengths = [e.geodesic_m for e in outcome.rows["episodes"]]
    assert lengths
    assert min(lengths) >= CONFIG.shortest_geodesic_m
    assert max(lengths) < CONFIG.min_geodesic_m
    assert any("0001" in line and "episodes from" in line for line in outcome.degradations)


def test_a_room_without_floor_for_the_agent_has_no_navmesh_but_reasons() -> None:
    tables, context = furnished({"0001": ("bed", [solid((2.0, 1.6, 0.5))], (1.0, 0.8, 0.0), 0.0)}, size=(2.1, 1.7))
    outcome = run(**tables, context=context, config=CONFIG)
    assert outcome.rows["navmeshes"] == outcome.rows["episodes"] == []
    assert [u.instance_id for u in outcome.rows["unreachable_targets"]] == ["0001"]
    assert "no floor is free" in outcome.degradations[0]
    assert len(outcome.rows["splits"]) == 1


def test_walls_are_no_targets_and_instances_without_an_asset_are_reported() -> None:
    tables, context = living_room()
    wall = dataclasses.replace(tables["instances"][0], instance_id="0100", category="wall", is_structure=True)
    bare = dataclasses.replace(tables["instances"][0], instance_id="0101", category="plant")
    of_wall = dataclasses.replace(tables["placements"][0], instance_id="0100")
    tables |= {"instances": [*tables["instances"], wall, bare], "placements": [*tables["placements"], of_wall]}
    outcome = run(**tables, context=context, config=CONFIG)
    assert "0100" not in {e.instance_id for e in outcome.rows["episodes"]}
    reasons = {u.instance_id: u.reason for u in outcome.rows["unreachable_targets"]}
    assert "0100" not in reasons
    assert reasons["0101"] == "no asset was placed for it"


def test_rows_that_do_not_fit_together_are_refused() -> None:
    tables, context = living_room()
    with pytest.raises(InputError, match=r"demo/room_00: placement 0001: asset .* is not in assets"):
        run(**{**tables, "assets": []}, context=context, config=CONFIG)
    with pytest.raises(InputError, match="placement 0001: its instance is not in instances"):
        run(**{**tables, "instances": tables["instances"][1:]}, context=context, config=CONFIG)
    with pytest.raises(InputError, match="shells: has no row"):
        run(**{**tables, "shells": []}, context=context, config=CONFIG)
    with pytest.raises(ValueError, match="turn_degrees: 50"):
        NavigationConfig(turn_degrees=50)
    with pytest.raises(ValueError, match=r"^height_m: must be above max_climb_m, 0\.2, is 0\.1$"):
        Agent(height_m=0.1)


@pytest.mark.parametrize(
    "values",
    [
        {"forward_m": 0.0}, {"turn_degrees": 0.0}, {"turn_degrees": math.inf}, {"turn_degrees": -30.0}, {"train_episodes": -1},
        {"test_episodes": -1}, {"test_share": 1.5}, {"test_share": math.nan}, {"max_steps": 0}, {"max_path_ratio": 0.9}, {"start_tries": 0},
        {"view_reach_m": 0.0}, {"view_spacing_m": math.nan}, {"view_directions": 0}, {"search_expansions": -1}, {"success_m": math.inf},
    ],
)  # fmt: skip
def test_settings_that_cannot_be_are_refused(values: dict[str, float]) -> None:
    (field,) = values
    with pytest.raises(ValueError, match=f"^{field}: must be "):
        NavigationConfig(**values)  # type: ignore[arg-type]
    assert NavigationConfig(train_episodes=0, test_episodes=0, test_share=0).test_share == 0


@pytest.mark.parametrize("values", [{"radius_m": 0.0}, {"radius_m": math.nan}, {"height_m": math.inf}, {"max_climb_m": -0.1}])
def test_an_agent_that_cannot_be_is_refused(values: dict[str, float]) -> None:
    (field,) = values
    with pytest.raises(ValueError, match=f"^{field}: must be "):
        Agent(**values)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^smallest_island_m2: must be at least 0, is -1$"):
        PlanarConfig(smallest_island_m2=-1.0)


def test_rooms_are_split_four_to_one_and_rescans_stay_together() -> None:
    names = [f"scannet/scene{i:04d}" for i in range(2000)]
    test = sum(split_of(name, 0.2) == "test" for name in names)
    assert abs(test - 400) < 4 * math.sqrt(2000 * 0.2 * 0.8)
    tables, context = living_room()
    splits = set()
    for scan in ("room_00", "room_01"):
        scene = dataclasses.replace(tables["scenes"][0], scene_id=f"demo/{scan}", scan=scan)
        few = dataclasses.replace(CONFIG, train_episodes=1, test_episodes=1)
        outcome = run(**{**tables, "scenes": [scene]}, context=dataclasses.replace(context, scene_id=scene.scene_id), config=few)
        splits |= {(row.room_id, row.split) for row in outcome.rows["splits"]}
        assert {e.split for e in outcome.rows["episodes"]} == {row.split for row in outcome.rows["splits"]}
    assert len(splits) == 1


def test_the_plan_is_a_picture_of_the_room_and_reproducible() -> None:
    import io

    from PIL import Image

    tables, context = living_room()
    episodes = run(**tables, context=context, config=CONFIG).rows["episodes"]
    placed = placed_surfaces(tables["placements"], tables["assets"], context.blobs)
    prints = {i: footprint(s, 0.2, 0.88) for i, s in placed.items()}
    floor = tables["shells"][0].floor_polygon
    free = free_space(floor, list(prints.values()), 0.18)
    picture = draw_plan(free, prints, episodes, floor)
    assert picture == draw_plan(free, prints, episodes, floor)
    pixels = np.asarray(Image.open(io.BytesIO(picture.png)).convert("RGB")).astype(int)
    assert min(pixels.shape[:2]) > 500
    green = (np.abs(pixels - (213, 232, 212)).max(axis=2) < 4).mean()
    brown = (np.abs(pixels - (176, 161, 143)).max(axis=2) < 4).mean()
    assert green > 0.1
    assert 0.005 < brown < green
    titles = re.findall(r"<title>([^<]*)</title>", picture.svg)
    assert {title.partition(":")[0] for title in titles if "in the way" in title} == {name for name, area in prints.items() if area.area}
    paths = [title for title in titles if title.startswith("episode ")]
    assert len(paths) == min(40, len(episodes))
    known = {f"episode {e.episode_id}: {e.geodesic_m:.2f} m to {e.category} {e.instance_id}" for e in episodes}
    assert set(paths) <= known


def test_the_declaration_names_what_run_takes_and_gives() -> None:
    tables, context = living_room()
    assert set(STAGE.reads) == set(tables)
    outcome = run(**tables, context=context, config=dataclasses.replace(CONFIG, train_episodes=1, test_episodes=1))
    assert tuple(outcome.rows) == STAGE.writes


@pytest.mark.whole
@pytest.mark.parametrize(
    ("kind", "slack"),
    # Recast rounds by cells: an outline may cut a corner by 1.3 of them.
    [pytest.param(PlanarConfig(), 0.0, id="planar"), pytest.param(RecastConfig(), 1.3 * 0.05, id="recast", marks=native)],
)
def test_real_furniture_is_walked_around(realdata: Callable[[str], Path], kind: PathFinderConfig, slack: float) -> None:
    """Models by others, dense and open and in many parts, at the poses that a person would give them."""
    folder = realdata("assets")
    objects = {}
    layout = {
        "aws_Bed_01": (1.4, 3.6, 0.0), "aws_Wardrobe_01": (5.2, 4.4, 0.3), "aws_SofaC_01": (4.3, 1.3, 0.6),
        "aws_KitchenTable_01": (2.0, 1.4, 0.2), "aws_ChairA_01": (2.9, 2.3, 1.0), "aws_Vase_01": (3.3, 3.2, 0.0),
    }  # fmt: skip
    for number, (name, (x, y, yaw)) in enumerate(layout.items()):
        parts = canonical(load_glb((folder / f"{name}.glb").read_bytes(), name))
        plain = [trimesh.Trimesh(part.vertices, part.faces, process=False) for part in parts]
        objects[f"{number:04d}"] = (name.split("_")[1].lower(), plain, (x, y, 0.0), yaw)
    tables, context = furnished(objects, size=(6.0, 5.0))
    config = dataclasses.replace(CONFIG, train_episodes=12, test_episodes=12, path_finder=kind)
    outcome = run(**tables, context=context, config=config)
    assert len(outcome.rows["episodes"]) == 12
    placed = placed_surfaces(tables["placements"], tables["assets"], context.blobs)
    # Independent of footprints: points on the surfaces at the agent's height, none nearer to any pose than its radius.
    rng = np.random.default_rng(0)
    points = np.concatenate([sample_surface(surface, 20_000, rng)[0] for surface in placed.values()])
    hit = points[(points[:, 2] >= config.agent.max_climb_m) & (points[:, 2] <= config.agent.height_m), :2]
    tree = cKDTree(hit)
    for e in outcome.rows["episodes"]:
        position, heading, poses = np.array(e.start_position[:2]), e.start_yaw_radians, []
        for action in e.actions:
            if action == "forward":
                step = 0.25 * np.array([math.cos(heading), math.sin(heading)])
                poses += [position + step * t for t in np.linspace(0, 1, 6)]
                position = position + step
            heading += {"left": math.pi / 6, "right": -math.pi / 6}.get(action, 0.0)
        assert tree.query(np.array(poses))[0].min() >= config.agent.radius_m - slack
        assert position == pytest.approx(e.final_position[:2], abs=1e-9)
