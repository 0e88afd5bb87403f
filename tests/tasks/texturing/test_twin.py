"""Textured twins: the asset's own geometry, with what the images of its instance show."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

from schemas.errors import InputError
from tasks.candidates.assets import make_asset
from tasks.furniture import generate
from tasks.geometry.meshes import dump_glb, load_glb, material_of, surface_of
from tasks.geometry.rendering import RayScene
from tasks.geometry.transforms import yaw_pose
from tasks.texturing.baking import BakeConfig
from tasks.texturing.twin import Twin, TwinConfig, textured_twin
from tasks.texturing.unwrapping import SmartUvUnwrapper, XatlasUnwrapper
from tasks.texturing.views import ColorView
from tests.tasks.texturing.painting import paint, ring, taken

POSE, SCALE = yaw_pose(0.7, (0.1, -0.2, -0.45)), (1.1, 0.9, 1.0)
CONFIG = TwinConfig(bake=BakeConfig(texel_m=0.01, max_px=512))


@pytest.fixture(scope="module")
def data() -> bytes:
    model = generate("chair", None, np.random.default_rng(4))
    made = make_asset(model.parts, provider="made", name="chair_1", category="chair", source="here", license="none")
    return made.files[made.asset.mesh_blob]


@pytest.fixture(scope="module")
def views(data: bytes) -> list[ColorView]:
    body = surface_of(load_glb(data)).transformed(POSE, SCALE).to_trimesh()
    return [taken(camera, [body]) for camera in ring(10, radius=1.8, size=(240, 180))]


@pytest.fixture(scope="module")
def twin(data: bytes, views: list[ColorView]) -> Twin:
    return textured_twin(data, POSE, SCALE, XatlasUnwrapper(), views, CONFIG)


def test_a_twin_is_the_same_body_with_one_texture(data: bytes, twin: Twin) -> None:
    assert twin.problem == ""
    before = load_glb(data)
    (part,) = load_glb(twin.glb)
    assert part.metadata["name"] == before[0].metadata["name"] == "chair_1|chair|000"
    surface = surface_of(before)
    assert (np.asarray(part.vertices)[part.faces] == surface.vertices[surface.faces]).all(), "its own frame and size, to the bit"
    image, factor = material_of(part)
    assert image is not None
    assert image.shape == (twin.side_px, twin.side_px, 3)
    assert (factor == 1).all()
    assert twin.figures is not None
    assert (twin.figures.overlap, twin.figures.outside) == (0, 0)
    assert twin.by.startswith("xatlas ")
    assert 0.4 < twin.seen_share <= 1.0


def test_a_twin_looks_as_its_instance_did(data: bytes, twin: Twin) -> None:
    (part,) = load_glb(twin.glb)
    part.vertices = surface_of([part]).transformed(POSE, SCALE).vertices
    camera = ring(10, radius=1.7, rise=0.7, size=(160, 120))[3]
    shown = RayScene([part]).render(camera, shade=False)
    hit = np.isfinite(shown.depth)
    rays = camera.rays()[hit].astype(np.float64)
    off = np.abs(shown.color[hit] - paint(rays[:, :3] + shown.depth[hit][:, None] * rays[:, 3:])).max(axis=1)
    assert np.median(off) < 4.0
    assert (off < 16).mean() > 0.9


def test_the_same_asset_gives_the_same_bytes(data: bytes, views: list[ColorView], twin: Twin) -> None:
    again = textured_twin(data, POSE, SCALE, XatlasUnwrapper(), views, CONFIG)
    assert dataclasses.replace(again, seconds=0.0) == dataclasses.replace(twin, seconds=0.0)


def test_what_no_image_shows_keeps_the_looks_of_all_parts(views: list[ColorView]) -> None:
    """A painted box and one with a texture, baked from no image at all, look as before."""
    box, board = trimesh.creation.box((0.4, 0.4, 0.4)), trimesh.creation.box((0.4, 0.4, 0.4))
    box.visual.vertex_colors = np.column_stack([np.arange(8) * 30, np.arange(8)[::-1] * 30, np.full(8, 90), np.full(8, 255)])
    board.apply_translation([1.0, 0, 0])
    from PIL import Image

    picture = np.zeros((64, 64, 3), dtype=np.uint8)
    picture[..., 0], picture[..., 1] = np.arange(64) * 4, np.arange(64)[:, None] * 4
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(picture), metallicFactor=0.0)
    board.visual = trimesh.visual.TextureVisuals(uv=np.asarray(board.vertices)[:, [1, 2]] + 0.5, material=material)
    data = dump_glb([box, board], ["a", "b"])
    config = TwinConfig(bake=BakeConfig(texel_m=0.005, max_px=512), least_seen=0.0)
    result = textured_twin(data, np.eye(4), (1, 1, 1), XatlasUnwrapper(), [], config)
    assert (result.problem, result.seen_share) == ("", 0.0)
    for camera in ring(4, radius=2.5, size=(120, 90)):
        old, new = (RayScene(load_glb(glb)).render(camera, shade=False) for glb in (data, result.glb))
        assert (np.isfinite(old.depth) == np.isfinite(new.depth)).all()
        off = np.abs(old.color.astype(int) - new.color).max(axis=-1)[np.isfinite(old.depth)]
        assert np.median(off) <= 4
        assert (off < 24).mean() > 0.97


class Stacked:
    """Lays all triangles upon each other."""

    kind, max_faces = "stacked", 10_000

    def corner_places(self, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, str]:
        return np.tile([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]], (len(faces), 1, 1)), "stacks"


def broken() -> np.ndarray:
    raise InputError("color/000003.jpg", "content", "is cut off", "export it again")


def test_why_there_is_no_twin(data: bytes, views: list[ColorView]) -> None:
    def problem(of: bytes = data, unwrapper: object = XatlasUnwrapper(), seen: list[ColorView] = views[:1], **settings: object) -> str:
        result = textured_twin(of, POSE, SCALE, unwrapper, seen, dataclasses.replace(CONFIG, **settings))  # type: ignore[arg-type]
        assert result.glb == b""
        return result.problem

    assert "asset.glb: content" in problem(b"glTF?")
    assert "more than 10; decimate it" in problem(unwrapper=XatlasUnwrapper(max_faces=10))
    assert problem(unwrapper=Stacked()) == "100.0% of its texture by stacks would be shown in more than one place"
    assert "is no program that can be run" in problem(unwrapper=SmartUvUnwrapper())
    assert "the images show 0.0% of its surface, less than 5.0%" in problem(seen=[])
    assert "color/000003.jpg" in problem(seen=[dataclasses.replace(views[0], color=broken)])
