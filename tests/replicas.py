"""Small replicas for the tests of the exports: generated furniture that stands where it should."""

from __future__ import annotations

import dataclasses
import hashlib
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from schemas.candidates import Asset
from schemas.captions import Caption
from schemas.capture import Instance, RoomSurface, Scene, Shell
from schemas.optimization import Placement, Support
from tasks import navigation
from tasks.capture.rooms.textures import room_charts
from tasks.exports import ExportsConfig
from tasks.exports.bodies import Replica, gather
from tasks.furniture import generate
from tasks.geometry.meshes import dump_glb, surface_of
from tasks.geometry.transforms import flat, translation, yaw_pose
from tasks.stage import Blobs, Context

ROOM = ((-3.0, -2.0), (3.0, -2.0), (3.0, 1.0), (1.0, 1.0), (1.0, 2.0), (-3.0, 2.0))


TABLES = ("scenes", "shells", "instances", "captions", "assets", "placements", "supports")
"""What an export is made of."""


@dataclasses.dataclass(frozen=True)
class Object:
    """An object to place. `pose`: 4x4 [m]. `known`: the asset comes with its convex pieces."""

    category: str
    parts: Sequence[trimesh.Trimesh]
    pieces: Sequence[trimesh.Trimesh]
    pose: np.ndarray
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    relation: str = "floor"
    parent_id: str | None = None
    known: bool = True
    mass_kg: float = 5.0
    friction: float = 0.5


def obj(category: str, pose: np.ndarray, seed: int = 0, **rest: Any) -> Object:
    """A generated piece of furniture."""
    model = generate(category, None, np.random.default_rng(seed))
    return Object(category, model.parts, model.pieces, pose, **rest)


def cube(size: Sequence[float], pose: np.ndarray, **rest: Any) -> Object:
    """A red box that stands on its origin."""
    mesh = trimesh.creation.box(size)
    mesh.apply_translation([0, 0, size[2] / 2])
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.tile(np.array([200, 40, 30, 255], np.uint8), (8, 1)))
    return Object("box", [mesh], [mesh], pose, **rest)


def room_of(scene_id: str = "demo/room_01", polygon: Sequence[Sequence[float]] = ROOM) -> Shell:
    """An L-shaped room."""
    return Shell(
        scene_id=scene_id, room_type="office", floor_polygon=tuple(tuple(map(float, p)) for p in polygon), floor_area_m2=22.0,
        floor_source="surface", walls=(), interior_walls=(), openings=None, slopes=None, lintels=None, height_m=2.6, height_source="walls",
        floor_color=None, wall_color=None,
    )  # fmt: skip


def rows_of(objects: Sequence[Object], scene_id: str = "demo/room_01") -> tuple[dict[str, list[Any]], Blobs]:
    """Rows of a scene up to optimization, by table, and the blobs they name."""
    blobs = Blobs()
    none = blobs.add(b"none", "ply")
    dataset, scan = scene_id.split("/")
    scene = Scene(
        scene_id=scene_id, room_id=scene_id, dataset=dataset, scan=scan, scan_format="scannet", scan_path="-", alignment=flat(np.eye(4)),
        alignment_source="identity", to_original=flat(np.eye(4)),
        floor_tilt_radians=0.0, mesh_blob=blobs.add(b"none", "glb"), vertex_count=3, face_count=1,
        frame_count=0, instance_count=len(objects), segmentation="file", license="CC0-1.0",
    )  # fmt: skip
    rows: dict[str, list[Any]] = {name: [] for name in ("instances", "captions", "placements", "supports")}
    rows |= {"scenes": [scene], "shells": [room_of(scene_id)], "surfaces": []}
    assets: dict[str, Asset] = {}
    for index, item in enumerate(objects):
        instance_id = f"{index + 1:04d}"
        glb = dump_glb(item.parts)
        asset_id = hashlib.sha256(glb).hexdigest()
        surface = surface_of(item.parts)
        pieces = blobs.add(dump_glb(item.pieces), "glb") if item.known else None
        extents = tuple(map(float, np.ptp(surface.vertices, axis=0)))
        assets[asset_id] = Asset(
            asset_id=asset_id, provider="procedural", name=item.category, category=item.category, source="generator", license="Apache-2.0",
            author=None, mesh_blob=blobs.add(glb, "glb"), pieces_blob=pieces,
            extents=extents, volume_m3=1.0, is_watertight=True, vertex_count=len(surface.vertices), face_count=len(surface.faces),
            open_reason=None, has_texture=False, source_url=None, thumbnail_blob=None,
        )  # fmt: skip
        pose = flat(item.pose)
        rows["instances"].append(
            Instance(
                scene_id=scene_id, instance_id=instance_id, source_id=instance_id, raw_label=item.category, category=item.category,
                nyu40_id=5, nyu40_label="chair", is_structure=False, found_by=None, category_probability=None,
                room_index=None, box_size=extents,
                box_pose=flat(item.pose @ translation([0, 0, extents[2] / 2])), box_volume_m3=float(np.prod(extents)), hidden_m=None,
                point_count=10,
                points_blob=none, mesh_blob=None, view_blob=None, best_frames=(),
            )
        )  # fmt: skip
        rows["captions"].append(
            Caption(
                scene_id=scene_id, instance_id=instance_id, provider="test", provider_version="1", is_fallback=False, sentence="an object",
                colors=(), color_shares=(), materials=(), shape="box", body_type="rigid", density_kg_m3=500.0, solid_fraction=0.5,
                mass_kg=item.mass_kg, friction=item.friction, restitution=0.1, attribute_source="test",
                appearance_call_id=None, physics_call_id=None,
            )
        )  # fmt: skip
        rows["placements"].append(
            Placement(
                scene_id=scene_id, instance_id=instance_id, asset_id=asset_id, origin="selection", annotator=None, annotation_match=None,
                scale=item.scale, proposed_pose=pose, optimized_pose=pose, displacement_m=0.0, lift_m=0.0, method="default",
                settled_pose=None, remains=None,
                collider_pieces=None, collider_faces=None, collider_early_share=None, collider_miss_share=None,
                collider_blob=None, collider_cut_share=None, collider_distance_m=None, fidelity_loss=None,
            )
        )  # fmt: skip
        rows["supports"].append(
            Support(
                scene_id=scene_id, instance_id=instance_id, relation=item.relation, parent_id=item.parent_id, against=None, gap_m=0.0,
                is_fixed=item.relation in ("wall", "ceiling"), is_kept=True, is_inferred=False, bracket_blob=None,
            )
        )  # fmt: skip
    rows["assets"] = [assets[key] for key in sorted(assets)]
    return rows, blobs


def replica_of(rows: dict[str, list[Any]], blobs: Blobs, config: ExportsConfig | None = None) -> Replica:
    """The replica that is exported, with nothing left out."""
    replica, missed = gather(*[rows[name] for name in TABLES], blobs, config or ExportsConfig(), surfaces=rows.get("surfaces", ()))
    assert missed == []
    return replica


def painted(rows: dict[str, list[Any]], blobs: Blobs) -> dict[str, list[Any]]:
    """The same rows with images of floor, walls and ceiling, whose pixels are random, and of the room's inner walls; one wall has none."""
    rng = np.random.default_rng(0)
    room = rows["shells"][0]
    surfaces = []
    for name, chart in room_charts(room):
        if name == "wall_03":
            continue
        image = Image.fromarray(rng.integers(0, 256, (8, 16, 3), dtype=np.uint8).repeat(8, axis=0).repeat(8, axis=1))
        out = io.BytesIO()
        image.save(out, format="JPEG", quality=95, subsampling=0)
        surfaces.append(
            RoomSurface(
                scene_id=room.scene_id, surface=name, texture_blob=blobs.add(out.getvalue(), "jpg"), origin=tuple(chart.origin.tolist()),
                u_axis=tuple(chart.u_axis.tolist()), v_axis=tuple(chart.v_axis.tolist()), width_m=chart.width, height_m=chart.height,
                texel_m=(chart.width / 128, chart.height / 64), seen_share=1.0, color=(128, 128, 128),
            )
        )  # fmt: skip
    return rows | {"surfaces": surfaces}


def with_navigation(
    rows: dict[str, list[Any]], blobs: Mapping[str, bytes], episodes: int = 6
) -> tuple[dict[str, list[Any]], dict[str, bytes]]:
    """The same rows with a navmesh and episodes."""
    scene_id = rows["scenes"][0].scene_id
    config = dataclasses.replace(navigation.NavigationConfig(), train_episodes=episodes, test_episodes=episodes)
    needed = {name: rows[name] for name in ("scenes", "shells", "placements", "instances", "assets")}
    outcome = navigation.run(**needed, context=Context(scene_id, "navigation", 0, blobs), config=config)
    return rows | {name: outcome.rows[name] for name in ("navmeshes", "episodes")}, {**blobs, **outcome.blobs}


def furnished() -> list[Object]:
    """An office: a table with a box on it, two equal chairs, a stretched box, a picture on the wall."""
    table = obj("table", translation([-1.5, 0.5, 0.0]), seed=3)
    top = float(surface_of(table.parts).vertices[:, 2].max())
    return [
        table,
        obj("chair", yaw_pose(0.4, [1.5, -1.0, 0.0]), seed=4, mass_kg=4.0),
        obj("chair", yaw_pose(2.4, [2.3, 0.2, 0.0]), seed=4, mass_kg=7.0, friction=0.8),
        cube((0.3, 0.2, 0.25), translation([-1.5, 0.5, top]), relation="on", parent_id="0001"),
        cube((0.3, 0.2, 0.25), yaw_pose(-0.7, [-0.2, -1.2, 0.0]), scale=(1.0, 2.0, 1.5), known=False),
        obj("picture", yaw_pose(-1.5707963, [0.0, 1.98, 1.4]), seed=5, relation="wall"),
    ]
