"""LiDAR meshes as apps on phones export them: names of files, axes, and textures, after what the apps' pages say."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from tasks.geometry.meshes import Surface, dump_glb
from tasks.geometry.transforms import Z_UP_TO_Y_UP, translation, yaw_pose
from tests.capture_scans import box_room
from tests.tasks.capture.formats.written import put
from tests.tasks.library.models import as_usdz

Array = NDArray[np.float64]

HEADING, HEIGHT = 0.83, 1.35
"""Of the phone when a scan starts, whose place is the origin [rad, m]."""


def phone_room() -> Surface:
    """A room in a phone's frame, but +Z up [m]: an arbitrary heading, the floor below the origin, no undersides, no ceiling."""
    room = box_room(cameras=1, ceiling=False, step=0.1).surface
    corners = room.vertices[room.faces]
    down = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] < 0
    kept = dataclasses.replace(room, faces=room.faces[~down])
    return kept.transformed(translation([0.4, -0.2, -HEIGHT]) @ yaw_pose(HEADING))


def atlas(surface: Surface) -> tuple[bytes, Array]:
    """A JPEG with a block of pixels for each color, and texture coordinates of vertices, v up, shape (n, 2)."""
    colors, number = np.unique(surface.colors, axis=0, return_inverse=True)
    block, across = 16, 8
    rows = int(np.ceil(len(colors) / across))
    image = np.zeros((rows * block, across * block, 3), dtype=np.uint8)
    for index, color in enumerate(colors):
        top, left = block * (index // across), block * (index % across)
        image[top : top + block, left : left + block] = color
    out = io.BytesIO()
    Image.fromarray(image).save(out, "JPEG", quality=97, subsampling=0)
    row, column = np.divmod(number.ravel(), across)
    return out.getvalue(), np.column_stack([(column + 0.5) / across, 1.0 - (row + 0.5) / rows])


def obj_files(stem: str, surface: Surface, image: str, material: str = "material0") -> dict[str, bytes | str]:
    """An OBJ, +Y up, its MTL and its image."""
    data, uv = atlas(surface)
    points = surface.vertices @ Z_UP_TO_Y_UP[:3, :3].T
    lines = [f"mtllib {stem}.mtl", *(f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points.tolist())]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in uv.tolist()]
    lines += [f"usemtl {material}", *("f " + " ".join(f"{i}/{i}" for i in face) for face in (surface.faces + 1).tolist())]
    library = f"newmtl {material}\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd {image}\n"
    return {f"{stem}.obj": "\n".join(lines) + "\n", f"{stem}.mtl": library, image: data}


def glb_file(surface: Surface, name: str) -> bytes:
    """A GLB with its texture in it."""
    data, uv = atlas(surface)
    image = Image.open(io.BytesIO(data))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image, metallicFactor=0.0)
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return dump_glb([mesh], [name])


def usdz_file(surface: Surface, layer: str, unit: float = 1.0) -> bytes:
    """A package with a layer, +Y up, and its texture."""
    data, uv = atlas(surface)
    points = ", ".join(f"({x:.6f}, {y:.6f}, {z:.6f})" for x, y, z in (surface.vertices @ Z_UP_TO_Y_UP[:3, :3].T / unit).tolist())
    corners = ", ".join(f"({u:.6f}, {v:.6f})" for u, v in uv.tolist())
    text = f"""#usda 1.0
(
    defaultPrim = "Scan"
    metersPerUnit = {unit}
    upAxis = "Y"
)
def Xform "Scan"
{{
    def Mesh "Mesh"
    {{
        rel material:binding = </Scan/Materials/Material>
        int[] faceVertexCounts = [{", ".join(["3"] * len(surface.faces))}]
        int[] faceVertexIndices = [{", ".join(map(str, surface.faces.ravel().tolist()))}]
        point3f[] points = [{points}]
        texCoord2f[] primvars:st = [{corners}] (interpolation = "vertex")
    }}
    def Scope "Materials"
    {{
        def Material "Material"
        {{
            token outputs:surface.connect = </Scan/Materials/Material/Surface.outputs:surface>
            def Shader "Surface"
            {{
                uniform token info:id = "UsdPreviewSurface"
                color3f inputs:diffuseColor.connect = </Scan/Materials/Material/Texture.outputs:rgb>
                token outputs:surface
            }}
            def Shader "Texture"
            {{
                uniform token info:id = "UsdUVTexture"
                asset inputs:file = @textures/texture.jpg@
                token inputs:sourceColorSpace = "sRGB"
                float2 inputs:st.connect = </Scan/Materials/Material/Reader.outputs:result>
                float3 outputs:rgb
            }}
            def Shader "Reader"
            {{
                uniform token info:id = "UsdPrimvarReader_float2"
                string inputs:varname = "st"
                float2 outputs:result
            }}
        }}
    }}
}}
"""
    return as_usdz({layer: text.encode(), "textures/texture.jpg": data})


def ply_file(surface: Surface, is_y_up: bool) -> bytes:
    """A binary PLY with normals and colors of vertices."""
    turned = surface.transformed(Z_UP_TO_Y_UP) if is_y_up else surface
    normals = trimesh.Trimesh(turned.vertices, turned.faces, process=False).vertex_normals
    vertex = np.zeros(len(turned.vertices), dtype=[("p", "<f4", 3), ("n", "<f4", 3), ("c", "u1", 4)])
    vertex["p"], vertex["n"], vertex["c"] = turned.vertices, normals, np.column_stack([turned.colors, np.full(len(turned.colors), 255)])
    face = np.zeros(len(turned.faces), dtype=[("k", "u1"), ("i", "<i4", 3)])
    face["k"], face["i"] = 3, turned.faces
    columns = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    columns += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue", "alpha"))
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertex)}\n{columns}"
    head += f"element face {len(face)}\nproperty list uchar int vertex_indices\nend_header\n"
    return head.encode() + vertex.tobytes() + face.tobytes()


def scaniverse(folder: Path, kind: str, surface: Surface) -> None:
    """Single files with the time in their names; an OBJ is a zip, unpacked here."""
    stem = "Scaniverse 2026-05-04 101112"
    files: dict[str, Callable[[], dict[str, bytes | str]]] = {
        "obj": lambda: {f"{stem}/{name}": data for name, data in obj_files(stem, surface, f"{stem}.jpg").items()},
        "glb": lambda: {f"{stem}.glb": glb_file(surface, "scan")},
        "usdz": lambda: {f"{stem}.usdz": usdz_file(surface, "scene.usda")},
        "ply": lambda: {f"{stem}.ply": ply_file(surface, is_y_up=False)},
    }
    put(folder, files[kind]())


def polycam(folder: Path, kind: str, surface: Surface) -> None:
    """Single files; an OBJ is a zip with `poly.*`; a GLB is also part of the raw data, with key frames."""
    files: dict[str, Callable[[], dict[str, bytes | str]]] = {
        "obj": lambda: {f"5_4_2026/{name}": data for name, data in obj_files("poly", surface, "poly.jpg", "defaultMat").items()},
        "glb": lambda: {"5_4_2026.glb": glb_file(surface, "mesh_0")},
        "usdz": lambda: {"5_4_2026.usdz": usdz_file(surface, "poly.usda", unit=0.01)},
        "ply": lambda: {"5_4_2026.ply": ply_file(surface, is_y_up=True)},
        "raw": lambda: _polycam_raw(surface),
    }
    put(folder, files[kind]())


def _polycam_raw(surface: Surface) -> dict[str, bytes | str]:
    """The raw data: a mesh, and key frames with depth."""
    image = io.BytesIO()
    Image.new("RGB", (64, 48), (90, 90, 90)).save(image, "JPEG")
    depth = io.BytesIO()
    Image.fromarray(np.full((48, 64), 1500, dtype=np.uint16)).save(depth, "PNG")
    camera = json.dumps({"fx": 50.0, "fy": 50.0, "cx": 32.0, "cy": 24.0, "width": 64, "height": 48, "t_00": 1.0})
    files: dict[str, bytes | str] = {"raw.glb": glb_file(surface, "mesh"), "thumbnail.jpg": image.getvalue(), "mesh_info.json": "{}"}
    for stamp in ("101112131", "101112231"):
        for place in ("images", "corrected_images"):
            files[f"keyframes/{place}/{stamp}.jpg"] = image.getvalue()
        for place in ("cameras", "corrected_cameras"):
            files[f"keyframes/{place}/{stamp}.json"] = camera
        for place in ("depth", "confidence"):
            files[f"keyframes/{place}/{stamp}.png"] = depth.getvalue()
    return {f"5_4_2026-poly/{name}": data for name, data in files.items()}


def scanner_3d(folder: Path, kind: str, surface: Surface) -> None:
    """3D Scanner App: `textured_output.obj` in a folder with the date; `all` is its "All Data" folder with frames."""
    name = "2026_05_04_10_11_12"
    mesh = obj_files("textured_output", surface, "textured_output.jpg")
    frame = json.dumps({"frame_index": 0, "intrinsics": [50.0, 0, 32.0, 0, 50.0, 24.0, 0, 0, 1]})
    more = {"info.json": "{}", "frame_00000.json": frame, "frame_00000.jpg": mesh["textured_output.jpg"]}
    files: dict[str, Callable[[], dict[str, bytes | str]]] = {
        "obj": lambda: {f"{name}/{key}": data for key, data in mesh.items()},
        "glb": lambda: {f"{name}.glb": glb_file(surface, "Mesh")},
        "usdz": lambda: {f"{name}.usdz": usdz_file(surface, "textured_output.usda")},
        "ply": lambda: {f"{name}.ply": ply_file(surface, is_y_up=True)},
        "all": lambda: {f"{name}/{key}": data for key, data in (mesh | more).items()},
    }
    put(folder, files[kind]())


APPS = {"Scaniverse": scaniverse, "Polycam": polycam, "3D Scanner App": scanner_3d}
KINDS = ("obj", "glb", "usdz", "ply")
