"""A scene as a recording for the Rerun viewer: scan, room, replica, colliders, navmeshes and what carries what.

The timeline `pose` has three moments: 0 is the proposed pose of every object, 1 the optimized, 2 the settled one, where there is one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from flows.view.scene import Document, Scenes
from schemas.errors import InputError
from schemas.files import write_whole
from schemas.parsing import json_value
from tasks.geometry.meshes import dump_glb, load_glb, surface_of, surface_of_glb
from tasks.geometry.transforms import Y_UP_TO_Z_UP, Z_UP_TO_Y_UP, matrix, quaternion_wxyz

TIMELINE, MOMENTS = "pose", ("proposed", "optimized", "settled")

GLB = "model/gltf-binary"

POINT_M = 0.006
"""Radius of the scan's points: those of a scan at 2 cm nearly touch."""

ABOVE_FLOOR_M = 0.01
"""How high a navmesh is drawn, so that the floor does not hide it."""

COLLIDER_RGBA, NAVMESH_RGBA, SUPPORT_RGBA = (90, 180, 110, 110), (70, 130, 220, 140), (230, 150, 40, 255)


def write_recording(scenes: Scenes, scene_id: str, out: Path) -> int:
    """Write a scene as a recording, whole or not at all; its size in bytes.

    World frame: right-handed, +Z up, metres. Textured parts and colliders are GLBs as in the lake.

    Raises:
        InputError: there is no such scene, the package is not installed, or recording was switched off.
    """
    try:
        import rerun
        import rerun.blueprint as views
    except ImportError as error:
        raise InputError("--rerun", str(out), "needs the package rerun-sdk", "pip install 'metascenes[rerun]'") from error
    document = scenes.shown(scene_id).document
    stream = rerun.RecordingStream("metascenes", recording_id=f"{scene_id} {scenes.reader.snapshot_id}")
    if not rerun.is_enabled(stream):
        raise InputError("RERUN", "the environment", "switches recording off", "unset it")
    collected = stream.binary_stream()
    scan = surface_of_glb(scenes.blob(document["scan"]), f"{scene_id} scan")
    hidden = {path: views.EntityBehavior(visible=False) for path in ("colliders", "scan/boxes")}
    world = views.Spatial3DView(origin="/", name=scene_id, overrides=hidden, eye_controls=_eye(scan.bounds))
    carriers, facts = views.GraphView(origin="supports/graph", name="supports"), views.TextDocumentView(origin="facts", name="facts")
    shown = views.Horizontal(world, views.Vertical(carriers, facts), column_shares=[3, 1])
    stream.send_blueprint(views.Blueprint(shown, views.TimePanel(timeline=TIMELINE)))
    stream.set_log_time_enabled(False)  # when a row was written says nothing of the scene
    stream.set_time(TIMELINE, sequence=0)
    stream.log("/", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, strict=True)
    stream.log("facts", rerun.TextDocument(_facts(scene_id, document)), static=True, strict=True)
    points = rerun.Points3D(scan.vertices, colors=scan.colors, radii=POINT_M)
    stream.log("scan/points", points, static=True, strict=True)
    if document["shell"] is not None:
        _log_model(stream, "room", scenes.blob(document["shell"]))
    for row in document["objects"]:
        _log_object(stream, row, scenes)
    for row in document["navmeshes"]:
        _log_navmesh(stream, row["agent"], json_value(scenes.blob(row["blob"])))
    _log_supports(stream, document["objects"])
    stream.flush()
    data = collected.read()
    stream.disconnect()
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, data)
    return len(data)


def _eye(bounds: NDArray[np.float64]) -> Any:
    """From a corner above what lies between two corners [m], shape (2, 3), down into it."""
    import rerun.blueprint as views

    middle, extent = bounds.mean(axis=0), float((bounds[1] - bounds[0])[:2].max())
    return views.EyeControls3D(position=middle + extent * np.array([-0.45, -0.6, 1.1]), look_target=middle, eye_up=(0.0, 0.0, 1.0))


def _facts(scene_id: str, document: Document) -> str:
    """What is known of a scene, as lines."""
    return "\n".join([scene_id, *(f"{name}: {value}" for name, value in document["facts"])])


def _log_object(stream: Any, row: Mapping[str, Any], scenes: Scenes) -> None:
    """An object: its box in the scan, its asset and collider at every moment."""
    import rerun

    box, size = matrix(row["box"]["pose"]), np.array(row["box"]["size"])
    turn = quaternion_wxyz(box)
    boxes = rerun.Boxes3D(
        centers=[box[:3, 3]], half_sizes=[size / 2], quaternions=[rerun.Quaternion(xyzw=[*turn[1:], turn[0]])],
        labels=[f"{row['id']} {row['category']}"], show_labels=False,
    )  # fmt: skip
    stream.log(f"scan/boxes/{row['id']}", boxes, static=True, strict=True)
    placed = row["placed"]
    if placed is None:
        return
    _log_model(stream, f"replica/{row['id']}/asset", scenes.blob(placed["blob"]), placed["scale"])
    roots = [f"replica/{row['id']}"]
    if row["collider"] is not None:
        roots.append(f"colliders/{row['id']}")
        _log_model(stream, f"{roots[1]}/pieces", scenes.blob(row["collider"]), color=COLLIDER_RGBA)
    for moment, name in enumerate(MOMENTS):
        if placed["poses"][name] is not None:
            pose = matrix(placed["poses"][name])
            stream.set_time(TIMELINE, sequence=moment)
            for root in roots:
                stream.log(root, rerun.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]), strict=True)


def _log_model(
    stream: Any, path: str, data: bytes, scale: Sequence[float] = (1.0, 1.0, 1.0), color: tuple[int, int, int, int] | None = None
) -> None:
    """A GLB, turned from its +Y up and then scaled along its own axes; one `color` takes the place of its materials.

    Parts with colors of vertices are meshes of their own: Rerun takes the linear `COLOR_0` of a GLB for sRGB.
    """
    import rerun

    frame = np.diag(np.asarray(scale, dtype=np.float64)) @ Y_UP_TO_Z_UP[:3, :3]
    stream.log(path, rerun.Transform3D(mat3x3=frame), static=True, strict=True)
    parts = [] if color is not None else load_glb(data)
    painted = [part for part in parts if cast(Any, part.visual).kind != "texture"]
    if painted:
        surface = surface_of(painted).transformed(Z_UP_TO_Y_UP)
        mesh = rerun.Mesh3D(
            vertex_positions=surface.vertices, triangle_indices=surface.faces.astype(np.uint32), vertex_colors=surface.colors
        )  # fmt: skip
        stream.log(path, mesh, static=True, strict=True)
    if len(painted) < len(parts) or color is not None:
        content = data if not painted else dump_glb([part for part in parts if cast(Any, part.visual).kind == "texture"])
        place = f"{path}/textured" if painted else path
        stream.log(place, rerun.Asset3D(contents=content, media_type=GLB, albedo_factor=color), static=True, strict=True)


def _log_navmesh(stream: Any, agent: str, triangles: Mapping[str, Any]) -> None:
    """Where an agent can go."""
    import rerun

    plan = np.array(triangles["points"], dtype=np.float64).reshape(-1, 2)
    vertices = np.column_stack([plan, np.full(len(plan), ABOVE_FLOOR_M)])
    mesh = rerun.Mesh3D(
        vertex_positions=vertices, triangle_indices=np.array(triangles["triangles"], dtype=np.uint32).reshape(-1, 3),
        albedo_factor=NAVMESH_RGBA,
    )  # fmt: skip
    stream.log(["navmesh", agent], mesh, static=True, strict=True)


def _log_supports(stream: Any, objects: Sequence[Mapping[str, Any]]) -> None:
    """What carries what: as a graph, and in the scene as lines from each object to what carries it, at every moment."""
    import rerun

    edges = [(row["support"]["parent"] or row["support"]["against"] or row["support"]["relation"], row["id"])
             for row in objects if row["support"] is not None]  # fmt: skip
    names = {row["id"]: f"{row['id']} {row['category']}" for row in objects}
    nodes = sorted({name for edge in edges for name in edge})
    if not edges:
        return
    stream.log(
        "supports/graph",
        rerun.GraphNodes(nodes, labels=[names.get(name, name) for name in nodes]),
        rerun.GraphEdges(edges, graph_type="directed"),
        static=True,
        strict=True,
    )
    for moment, name in enumerate(MOMENTS):
        places = {row["id"]: _origin(row["placed"]["poses"], name) for row in objects if row["placed"] is not None}
        strips = [[places[carried], places[carrier]] for carrier, carried in edges if carrier in places and carried in places]
        stream.set_time(TIMELINE, sequence=moment)
        stream.log("supports/lines", rerun.LineStrips3D(strips, colors=[SUPPORT_RGBA], radii=POINT_M), strict=True)


def _origin(poses: Mapping[str, Any], moment: str) -> NDArray[np.float64]:
    """The bottom center of a placed asset [m], shape (3,); what did not settle stays where it was optimized to."""
    return np.asarray(matrix(poses[moment] or poses["optimized"])[:3, 3])
