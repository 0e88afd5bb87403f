"""A glTF with its buffers and images is the same model as the GLB of it; files that are not models are counted."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
import trimesh
from PIL import Image

from schemas.errors import InputError
from tasks.candidates.assets import has_image
from tasks.containers import close_glb, open_glb
from tasks.geometry.meshes import dump_glb, surface_of
from tasks.library.formats import content_of, model_files, read_model, skipped_note

COLOR = (200, 120, 60)


def write_gltf(folder: Path, buffer: str = "chair.bin", image: str = "wood.png", is_embedded: bool = False) -> Path:
    """A textured box as a glTF whose buffer and image lie in files, or in data URIs."""
    folder.mkdir(parents=True, exist_ok=True)
    box = trimesh.creation.box()
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.new("RGB", (8, 8), COLOR))
    box.visual = trimesh.visual.TextureVisuals(uv=np.full((len(box.vertices), 2), 0.5), material=material)
    document, binary = open_glb(dump_glb([box], ["chair"]))
    (folder / "whole.glb").write_bytes(close_glb(document, binary))
    encoded = io.BytesIO()
    Image.new("RGB", (8, 8), COLOR).save(encoded, "PNG")
    document["images"] = [{"uri": quote(image)}]
    document["buffers"] = [{"byteLength": len(binary), "uri": quote(buffer)}]
    if is_embedded:
        document["images"][0]["uri"] = "data:image/png;base64," + base64.b64encode(encoded.getvalue()).decode()
        document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    else:
        for name, data in ((buffer, binary), (image, encoded.getvalue())):
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_bytes(data)
    (folder / "chair.gltf").write_text(json.dumps(document))
    return folder / "chair.gltf"


@pytest.mark.parametrize(
    ("buffer", "image", "is_embedded"),
    [("chair.bin", "wood.png", False), ("my chair.bin", "textures/my wood.png", False), ("chair.bin", "wood.png", True)],
)
def test_a_gltf_is_the_model_of_its_glb(tmp_path: Path, buffer: str, image: str, is_embedded: bool) -> None:
    path = write_gltf(tmp_path, buffer, image, is_embedded)
    model, whole = read_model(path, tmp_path), read_model(tmp_path / "whole.glb", tmp_path)
    assert np.array_equal(surface_of(model.parts).vertices, surface_of(whole.parts).vertices)
    assert (surface_of(model.parts).colors == COLOR).all()
    assert has_image(model.parts[0])
    assert (model.format, model.unit_m, model.up, model.notes) == ("gltf", 1.0, "y", ())


def test_the_files_of_a_gltf_count_for_its_content(tmp_path: Path) -> None:
    path = write_gltf(tmp_path)
    before = content_of(path, tmp_path)
    (tmp_path / "wood.png").write_bytes((tmp_path / "wood.png").read_bytes() + b"\0")
    assert content_of(path, tmp_path) != before


def test_a_missing_image_is_told_and_a_missing_buffer_is_refused(tmp_path: Path) -> None:
    path = write_gltf(tmp_path)
    (tmp_path / "wood.png").unlink()
    model = read_model(path, tmp_path)
    assert model.notes == ("chair.gltf: 'wood.png' is missing, drawn without it",)
    assert not has_image(model.parts[0])
    (tmp_path / "chair.bin").unlink()
    with pytest.raises(InputError, match=r"chair\.gltf: buffer 0: 'chair\.bin' is missing; copy it next to the glTF"):
        read_model(path, tmp_path)


@pytest.mark.parametrize("uri", ["../secret.bin", "file:///etc/passwd", "https://example.org/a.bin", "/etc/passwd", "..%2Fsecret.bin"])
def test_a_gltf_opens_nothing_outside_of_its_folder(tmp_path: Path, uri: str) -> None:
    path = write_gltf(tmp_path / "library")
    (tmp_path / "secret.bin").write_bytes((path.parent / "chair.bin").read_bytes())
    (path.parent / "chair.bin").unlink()
    document = json.loads(path.read_text())
    document["buffers"][0]["uri"] = uri
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match="outside of the folder"):
        read_model(path, path.parent)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"asset": {"version": "1.0"}}', '{"asset": {"version": "2.0"}}', '{"asset": 2}', "\xff"])
def test_a_broken_gltf_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.gltf").write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError):
        read_model(tmp_path / "a.gltf", tmp_path)


def test_files_that_are_not_models_are_counted_by_ending(tmp_path: Path) -> None:
    write_gltf(tmp_path)
    for name in ("a.fbx", "b.FBX", "c.stl", "index.json", "LICENSE", ".hidden"):
        (tmp_path / name).touch()
    assert [path.name for path in model_files(tmp_path)[0]] == ["chair.gltf", "whole.glb"]
    (line,) = skipped_note(tmp_path)
    assert line.startswith("skipped files that are not models: 2 .fbx, 1 .stl; convert models to one of .glb, .gltf,")


def test_features_of_a_gltf_that_are_not_read_are_noted(tmp_path: Path) -> None:
    path = write_gltf(tmp_path)
    document = json.loads(path.read_text())
    document |= {"cameras": [{"type": "perspective"}], "animations": [{"channels": [], "samplers": []}]}
    path.write_text(json.dumps(document))
    assert [note.partition(": ")[2] for note in read_model(path, tmp_path).notes] == [
        "animations: are not played: the pose at rest is read", "cameras: are not read",
    ]  # fmt: skip
