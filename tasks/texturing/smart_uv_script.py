"""Run by an interpreter that has `bpy`, or by Blender itself, never imported: a mesh in, places in the texture out.

Only bpy and NumPy are there. The folder that is named holds `vertices.f8`, `faces.i8` and `settings.f8` (angle limit [rad], island
margin); `uv.f4` (a place for every corner of every face, in their order) and `version.txt` are left in it.
"""

import sys
from pathlib import Path

import bpy
import numpy as np


def mesh_of(vertices: np.ndarray, faces: np.ndarray) -> "bpy.types.Mesh":
    """The triangles as a mesh of Blender, corner by corner."""
    mesh = bpy.data.meshes.new("asset")
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.astype(np.int32).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    return mesh


def main(folder: Path) -> None:
    """Unwrap the mesh in the folder."""
    vertices = np.fromfile(folder / "vertices.f8", dtype="<f8").reshape(-1, 3)
    faces = np.fromfile(folder / "faces.i8", dtype="<i8").reshape(-1, 3)
    angle_limit, island_margin = np.fromfile(folder / "settings.f8", dtype="<f8").tolist()
    for item in list(bpy.data.objects):  # a camera, a lamp and a cube of the factory's settings
        bpy.data.objects.remove(item)
    mesh = mesh_of(vertices, faces)
    mesh.uv_layers.new(name="atlas")
    body = bpy.data.objects.new("asset", mesh)
    bpy.context.scene.collection.objects.link(body)
    bpy.context.view_layer.objects.active = body
    body.select_set(True)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(
        angle_limit=angle_limit, margin_method="FRACTION", island_margin=island_margin, area_weight=0.0, correct_aspect=False,
        scale_to_bounds=False,
    )  # fmt: skip
    bpy.ops.object.mode_set(mode="OBJECT")
    if len(mesh.polygons) != len(faces):
        sys.exit(f"{len(faces)} faces went in, {len(mesh.polygons)} came out")
    order = np.empty(len(mesh.loops), dtype=np.int32)
    mesh.loops.foreach_get("vertex_index", order)
    if (order.reshape(-1, 3) != faces).any():
        sys.exit("faces came out in another order")
    places = np.empty(2 * len(mesh.loops), dtype=np.float32)
    mesh.uv_layers.active.data.foreach_get("uv", places)
    places.astype("<f4").tofile(folder / "uv.f4")
    np.frombuffer(bpy.app.version_string.encode(), dtype=np.uint8).tofile(folder / "version.txt")


if __name__ == "__main__":
    main(Path(sys.argv[-1]))
