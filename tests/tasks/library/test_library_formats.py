"""Models of every format come out the same, and what is broken, hostile or too large is refused in one line."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from schemas.errors import InputError
from tasks.capture.files.obj import parse_obj
from tasks.geometry.colors import bytes_of_linear, linear_of_bytes
from tasks.geometry.meshes import surface_of, vertex_colors
from tasks.library.formats import content_of, model_files, read_model
from tasks.library.metadata import ModelFacts
from tasks.library.units import canonical_parts, convention_of
from tasks.library.usd.child import drawn_on, unpacked
from tasks.library.usd.stage import Flattened
from tests import attacks
from tests.tasks.geometry.colored import decoded, encoded
from tests.tasks.library.models import as_glb, as_obj, as_usdz, chair, farthest, write_usd


def canonical_of(path: Path, category: str = "chair") -> list[trimesh.Trimesh]:
    model = read_model(path, path.parent)
    return canonical_parts(model, convention_of(model, ModelFacts(), category))


@pytest.mark.whole
def test_one_model_is_the_same_in_every_format(tmp_path: Path) -> None:
    parts = chair()
    (tmp_path / "a.glb").write_bytes(as_glb(parts))
    (tmp_path / "b.obj").write_bytes(as_obj(parts, 0.01, "y"))
    write_usd(tmp_path / "c.usda", parts, 0.01, "y")
    write_usd(tmp_path / "d.usdc", parts, 0.0254, "z")
    (tmp_path / "e.usdz").write_bytes(as_usdz({"d.usdc": (tmp_path / "d.usdc").read_bytes()}))
    for path in sorted(tmp_path.iterdir()):
        made = canonical_of(path)
        assert farthest(made, parts) < 1e-5, path.name
        if path.suffix != ".obj":
            assert np.abs(np.unique(surface_of(made).colors, axis=0) - np.unique(surface_of(parts).colors, axis=0).astype(int)).max() <= 1
    hashes = {content_of(path, tmp_path) for path in tmp_path.iterdir()}
    assert len(hashes) == 5


def write_scene(path: Path) -> None:
    """Two native instances of a prototype, a point instancer, a mirrored left-handed quad, and what is not drawn; in feet."""
    path.write_text("""#usda 1.0
(
    metersPerUnit = 0.3048
    upAxis = "Z"
    defaultPrim = "Root"
)
def Xform "Root"
{
    class Xform "Leg"
    {
        def Cube "C"
        {
            double size = 1
            color3f[] primvars:displayColor = [(1, 0, 0)]
        }
    }
    def Xform "A" (
        instanceable = true
        inherits = </Root/Leg>
    )
    {
        double3 xformOp:translate = (10, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Xform "B" (
        instanceable = true
        inherits = </Root/Leg>
    )
    {
        double3 xformOp:translate = (-10, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def PointInstancer "P"
    {
        rel prototypes = [</Root/P/Ball>]
        int[] protoIndices = [0, 0]
        point3f[] positions = [(0, 20, 0), (0, -20, 0)]
        def Sphere "Ball"
        {
            double radius = 2
        }
    }
    def Mesh "Quad"
    {
        uniform token orientation = "leftHanded"
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, 0, 30), (0, 1, 30), (1, 1, 30), (1, 0, 30)]
        color3f[] primvars:displayColor = [(0, 1, 0)] (
            interpolation = "constant"
        )
    }
    def Cylinder "Rod"
    {
        uniform token axis = "X"
        double height = 60
        double radius = 0.5
        double3 xformOp:translate = (0, 0, -10)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Cube "Hidden"
    {
        token visibility = "invisible"
        double size = 500
    }
    def Cube "Guide"
    {
        uniform token purpose = "guide"
        double size = 500
    }
}
""")


def test_usd_instances_are_flattened_and_solids_are_meshes(tmp_path: Path) -> None:
    write_scene(tmp_path / "scene.usda")
    flat = Flattened(tmp_path / "scene.usda", tmp_path)
    (mesh,) = flat.parts()
    assert (flat.unit_m, flat.up, flat.notes) == (pytest.approx(0.3048), "z", [])
    pieces = trimesh.Trimesh(mesh.vertices, mesh.faces).split(only_watertight=False)
    centers = sorted(tuple(np.round(piece.bounds.mean(axis=0), 3).tolist()) for piece in pieces)
    assert centers == sorted([(10, 0, 0), (-10, 0, 0), (0, 20, 0), (0, -20, 0), (0.5, 0.5, 30), (0, 0, -10)])
    sizes = {tuple(np.round(np.ptp(piece.bounds, axis=0), 2).tolist()) for piece in pieces}
    assert {(1, 1, 1), (1, 1, 0), (60, 1, 1)} <= sizes
    quad = next(piece for piece in pieces if len(piece.faces) == 2)
    assert np.allclose(quad.face_normals, [0, 0, 1]), "left-handed faces look the other way"
    colors = {tuple(color) for color in np.asarray(vertex_colors(mesh)).tolist()}
    assert {(255, 0, 0), (0, 255, 0)} <= colors
    closed = [piece for piece in pieces if len(piece.faces) > 2]
    assert all(piece.is_watertight and piece.volume > 0 for piece in closed)


@given(st.integers(0, 255))
def test_colors_of_usd_are_linear(value: int) -> None:
    gray = np.full((1, 3), value, dtype=np.uint8)
    assert (bytes_of_linear(linear_of_bytes(gray)) == gray).all()


LOOK = """
def Mesh "m" ( prepend apiSchemas = ["MaterialBindingAPI"] )
{
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    texCoord2f[] primvars:st = [(0.5, 0.5), (0.5, 0.5), (0.5, 0.5)] (interpolation = "vertex")
    rel material:binding = </look>
}
def Material "look"
{
    token outputs:surface.connect = </look/surface.outputs:surface>
    def Shader "surface"
    {
        uniform token info:id = "UsdPreviewSurface"
        %s
        token outputs:surface
    }
    def Shader "image"
    {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @./image.png@
        %s
        float3 outputs:rgb
    }
}
"""
IMAGE_COLOR = "color3f inputs:diffuseColor.connect = </look/image.outputs:rgb>"
LOOKS = {
    "image": (IMAGE_COLOR, "", (200, 180, 220)),
    "sRGB image and scale": (
        IMAGE_COLOR,
        'token inputs:sourceColorSpace = "sRGB"\n float4 inputs:scale = (0.5, 0.25, 1, 1)',
        encoded(decoded((200, 180, 220)) * [0.5, 0.25, 1.0]),
    ),
    "linear image": (IMAGE_COLOR, 'token inputs:sourceColorSpace = "raw"', encoded(np.array([200, 180, 220]) / 255)),
    "color": ("color3f inputs:diffuseColor = (0.5, 0.25, 0.01)", "", encoded([0.5, 0.25, 0.01])),
    "light alone": (
        "color3f inputs:diffuseColor = (0, 0, 0)\n color3f inputs:emissiveColor = (0.5, 0.25, 0.01)", "", encoded([0.5, 0.25, 0.01]),
    ),
    "light of a colored thing": (
        "color3f inputs:diffuseColor = (0.5, 0.25, 0)\n color3f inputs:emissiveColor = (0, 0, 1)", "", encoded([0.5, 0.25, 0]),
    ),
}  # fmt: skip


@pytest.mark.parametrize(("inputs", "image", "expected"), LOOKS.values(), ids=LOOKS.keys())
def test_materials_of_usd_show_their_colors(tmp_path: Path, inputs: str, image: str, expected: np.ndarray) -> None:
    Image.new("RGB", (4, 4), (200, 180, 220)).save(tmp_path / "image.png")
    path = write_layer(tmp_path / "look.usda", LOOK % (inputs, image))
    (part,) = Flattened(path, tmp_path).parts()
    np.testing.assert_allclose(vertex_colors(part), np.tile(expected, (3, 1)), atol=1)


@pytest.mark.parametrize(
    ("inputs", "is_told"),
    [
        ("float inputs:opacity = 1", False),
        ("float inputs:opacity = 0.4", True),
        ("float inputs:opacity.connect = </look/image.outputs:a>", True),
        ("color3f inputs:diffuseColor = (1, 0, 0)", False),
    ],
)
def test_meshes_of_usd_that_let_light_through_are_told_of(tmp_path: Path, inputs: str, is_told: bool) -> None:
    Image.new("RGBA", (4, 4), (200, 180, 220, 90)).save(tmp_path / "image.png")
    path = write_layer(tmp_path / "look.usda", LOOK % (inputs, "float outputs:a"))
    assert Flattened(path, tmp_path).notes == ["meshes that let light through are read as solid: 1"] * is_told


def write_layer(path: Path, text: str) -> Path:
    path.write_text(f"#usda 1.0\n{text}\n")
    return path


MESH = 'def Mesh "m"\n{\n    point3f[] points = [%s]\n    int[] faceVertexCounts = [%s]\n    int[] faceVertexIndices = [%s]\n}'


VARIANT = """def "a" (
    variants = {
        string v = "x"
    }
    prepend variantSets = "v"
)
{
    variantSet "v" = {
        "x" (
            references = @/b.usda@
        ) {
        }
    }
}"""


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('def "a" (references = @/etc/model.usda@)\n{\n}', "leads out of the folder"),
        ('def "a" (references = @../other.usda@)\n{\n}', "leads out of the folder"),
        ('def "a" (payload = @sub/../../other.usda@)\n{\n}', "leads out of the folder"),
        (VARIANT, "leads out of the folder"),
        ('def "a" (references = @https://example.com/b.usda@)\n{\n}', "is no plain path"),
        ('def "a" (references = @b.usdz[c.usda]@)\n{\n}', "is no plain path"),
        ('def "a" (references = @b.usda:SDF_FORMAT_ARGS:x=1@)\n{\n}', "is no plain path"),
        ('def "a" (references = @b.abc@)\n{\n}', "is no layer"),
        ('def "a" (references = @link.usda@)\n{\n}', "leads out of the folder"),
        ('def "a"\n{\n    asset inputs:file = @/etc/passwd.png@\n}', "leads out of the folder"),
        ('def "a" (clips = {dictionary default = {asset[] assetPaths = [@/etc/a.usd@]}})\n{\n}', "value clips"),
    ],
)  # fmt: skip
def test_usd_that_draws_on_what_lies_elsewhere_is_refused_before_it_is_opened(tmp_path: Path, text: str, problem: str) -> None:
    folder = tmp_path / "library"
    folder.mkdir()
    write_layer(tmp_path / "other.usda", MESH % ("(0, 0, 0), (1, 0, 0), (0, 1, 0)", "3", "0, 1, 2"))
    (folder / "link.usda").symlink_to(tmp_path / "other.usda")
    with pytest.raises(InputError, match=problem) as caught:
        drawn_on(write_layer(folder / "a.usda", text), folder)
    assert "\n" not in str(caught.value)


def test_layers_below_layers_are_followed(tmp_path: Path) -> None:
    write_layer(tmp_path / "c.usda", 'def "c"\n{\n    asset a = @wood.png@\n    asset b = @gone.png@\n}')
    write_layer(tmp_path / "b.usda", '(\n    subLayers = [@./c.usda@]\n)\ndef "b" (references = @a.usda@)\n{\n}')
    (tmp_path / "wood.png").write_bytes(attacks.png(4))
    path = write_layer(tmp_path / "a.usda", 'def "a" (references = @b.usda@)\n{\n}')
    files, notes = drawn_on(path, tmp_path)
    assert [file.name for file in files] == ["b.usda", "c.usda", "wood.png"]
    assert notes == ["gone.png is missing"]


@pytest.mark.parametrize(
    ("mesh", "problem"),
    [
        (("(0, 0, 0), (1, 0, 0), (0, 1, 0)", "3", "0, 1, 7"), "points that are not there"),
        (("(0, 0, 0), (1, 0, 0), (0, 1, 0)", "3", "0, 1, -1"), "points that are not there"),
        (("(0, 0, 0), (1, 0, 0), (0, 1, 0)", "4", "0, 1, 2"), "where its faces count 4"),
        (("", "", ""), "no triangles that are drawn"),
    ],
)
def test_usd_whose_numbers_do_not_fit_together_is_refused(tmp_path: Path, mesh: tuple[str, ...], problem: str) -> None:
    path = write_layer(tmp_path / "a.usda", MESH % mesh)
    with pytest.raises(InputError, match=problem):
        Flattened(path, tmp_path).parts()


def instances(count: int) -> str:
    zeros, places = ", ".join(["0"] * count), ", ".join(["(0, 0, 0)"] * count)
    return (
        f'def PointInstancer "p"\n{{\n    rel prototypes = [</p/c>]\n    int[] protoIndices = [{zeros}]\n'
        f"    point3f[] positions = [{places}]\n"
        '    def Sphere "c"\n    {\n    }\n}'
    )


@pytest.mark.parametrize(("count", "problem"), [(40_000, "instances: are 40000"), (5_000, "as often as they are placed")])
def test_usd_that_asks_for_much_by_little_is_refused(tmp_path: Path, count: int, problem: str) -> None:
    path = write_layer(tmp_path / "a.usda", instances(count))
    with pytest.raises(InputError, match=problem):
        Flattened(path, tmp_path)


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (as_usdz({"a.usda": b"#usda 1.0\n" + b" " * 10_000_000}, zipfile.ZIP_DEFLATED), "in [0-9]+;"),
        (as_usdz({"a.usda": b"#usda 1.0\n" * 3}, zipfile.ZIP_DEFLATED), "compressed|holds 1 files"),
        (as_usdz({"../a.usda": b"#usda 1.0\n"}), "lies outside of it"),
        (as_usdz({"/a.usda": b"#usda 1.0\n"}), "lies outside of it"),
        (as_usdz({"a.png": b""}), "first file is no layer"),
        (as_usdz({f"{n}.usda": b"" for n in range(300)}), "holds 300 files"),
        (b"PK nothing", "is no zip archive"),
    ],
)
def test_packages_that_are_none_are_refused(tmp_path: Path, data: bytes, problem: str) -> None:
    (tmp_path / "a.usdz").write_bytes(data)
    with pytest.raises(InputError, match=problem):
        unpacked(tmp_path / "a.usdz", tmp_path / "package")
    assert not (tmp_path / "a.usda").exists()


@pytest.mark.whole
def test_a_reader_that_takes_too_much_ends_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The limits are the child's: it dies of them, and the reason is a line."""
    import dataclasses

    from tasks import confinement as children
    from tasks.library import confinement

    (tmp_path / "a.usda").write_text("#usda 1.0\n")
    small = dataclasses.replace(children.BUDGET, seconds=1.0)
    for code, problem in (
        ("import time, sys, tasks.confinement as c; c.limit(1, 2**31)\nwhile True: pass", "takes more than"),
        ("import tasks.confinement as c; c.limit(9, 2**27); x = bytearray(2**30)", "MB of memory"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "dies \\(SIGSEGV\\)"),
        ("pass", "cannot be read"),
    ):
        monkeypatch.setattr(children, "BUDGET", small)
        monkeypatch.setattr(confinement, "CODE", code)
        with pytest.raises(InputError, match=problem):
            confinement.confined("read", tmp_path / "a.usda", tmp_path, "a.usda")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "vertex 4 of 3"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n", "vertex 0"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -4\n", "vertex -4"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x\n", "faces: one is"),
        ("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("v inf 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1" + " 2" * 5000 + "\n", "5001 corners"),
        ("v 0 0 0\n", "."),
        ("", "."),
        ("mtllib /etc/passwd\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "outside"),
        ("mtllib ../secret.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "outside"),
    ],
)  # fmt: skip
def test_an_obj_that_is_broken_or_leads_elsewhere_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    folder = tmp_path / "library"
    folder.mkdir()
    (tmp_path / "secret.mtl").write_text("newmtl a\nKd 1 0 0\n")
    (folder / "a.obj").write_text(text)
    with pytest.raises(InputError, match=problem):
        read_model(folder / "a.obj", folder)


@given(st.lists(st.integers(1, 5), min_size=3, max_size=8), st.integers(3, 6))
def test_faces_of_an_obj_may_name_what_is_there(corners: list[int], count: int) -> None:
    text = "".join(f"v {n} 0 0\nvt 0 0\n" for n in range(count)) + "f " + " ".join(f"{c}/1/1" for c in corners) + "\n"
    if max(corners) <= count:
        assert parse_obj(text.encode(), "a.obj").faces.max() < count
    else:
        with pytest.raises(InputError):
            parse_obj(text.encode(), "a.obj")


def test_an_obj_has_its_textures_and_they_count_for_its_content(tmp_path: Path) -> None:
    (tmp_path / "a.mtl").write_text("newmtl wood\nKd 1 1 1\nmap_Kd wood.png\n")
    (tmp_path / "wood.png").write_bytes(attacks.png(8))
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nusemtl wood\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    model = read_model(tmp_path / "a.obj", tmp_path)
    assert model.parts[0].visual.kind == "texture"
    before = content_of(tmp_path / "a.obj", tmp_path)
    (tmp_path / "wood.png").write_bytes(attacks.png(9))
    assert content_of(tmp_path / "a.obj", tmp_path) != before
    (tmp_path / "wood.png").unlink()
    assert "wood.png is missing" in read_model(tmp_path / "a.obj", tmp_path).notes[0]


def external() -> bytes:
    return attacks.glb([{"mesh": 0}], [0], images=[{"uri": "file:///etc/passwd"}])


@pytest.mark.parametrize(
    "make",
    [attacks.without_buffer, attacks.placed, attacks.nested, attacks.deep_json, external, lambda: attacks.textured(attacks.png(300)[:100]),
     lambda: b"glTF"],
)  # fmt: skip
def test_a_hostile_glb_is_refused_in_one_line(tmp_path: Path, make: Callable[[], bytes]) -> None:
    (tmp_path / "a.glb").write_bytes(make())
    with pytest.raises(InputError) as caught:
        read_model(tmp_path / "a.glb", tmp_path)
    assert str(caught.value).isprintable()


def test_pictures_of_absurd_size_are_refused_before_they_are_decoded(tmp_path: Path) -> None:
    from tests.tasks.library.pictures import png_head

    (tmp_path / "a.glb").write_bytes(attacks.textured(png_head(60_000, 60_000)))
    with pytest.raises(InputError, match="pixels"):
        read_model(tmp_path / "a.glb", tmp_path)
    write_layer(
        tmp_path / "b.usda",
        'def Mesh "m" (prepend apiSchemas = ["MaterialBindingAPI"])\n{\n    rel material:binding = </mat>\n'
        "    int[] faceVertexCounts = [3]\n"
        "    int[] faceVertexIndices = [0, 1, 2]\n    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]\n"
        '    texCoord2f[] primvars:st = [(0, 0), (1, 0), (0, 1)] (interpolation = "vertex")\n}\n'
        'def Material "mat"\n{\n    token outputs:surface.connect = </mat/s.outputs:surface>\n    def Shader "s"\n    {\n'
        '        uniform token info:id = "UsdPreviewSurface"\n        color3f inputs:diffuseColor.connect = </mat/t.outputs:rgb>\n'
        '        token outputs:surface\n    }\n    def Shader "t"\n    {\n        uniform token info:id = "UsdUVTexture"\n'
        "        asset inputs:file = @large.png@\n        float3 outputs:rgb\n    }\n}",
    )
    (tmp_path / "large.png").write_bytes(png_head(60_000, 60_000))
    with pytest.raises(InputError, match="pixels"):
        Flattened(tmp_path / "b.usda", tmp_path).parts()
    (tmp_path / "large.png").write_bytes(attacks.png(8))
    (part,) = Flattened(tmp_path / "b.usda", tmp_path).parts()
    assert part.visual.kind == "texture"
    assert part.visual.material.baseColorTexture.size == (8, 8)


def test_a_folder_is_listed_whatever_lies_in_it(tmp_path: Path) -> None:
    import os

    folder = tmp_path / "library"
    (folder / "more").mkdir(parents=True)
    for name in ("b.glb", "more/a.OBJ", "c.usdz", "readme.txt"):
        (folder / name).write_bytes(b"")
    (tmp_path / "outside.glb").write_bytes(b"")
    (folder / "link.glb").symlink_to(tmp_path / "outside.glb")
    (folder / "gone.obj").symlink_to("nowhere.obj")
    (folder / "folder").symlink_to(tmp_path)
    os.mkfifo(folder / "pipe.glb")
    files, unused = model_files(folder)
    assert [file.relative_to(folder).as_posix() for file in files] == ["b.glb", "c.usdz", "more/a.OBJ"]
    assert [line.partition(":")[0] for line in unused] == ["folder", "gone.obj", "link.glb", "pipe.glb"]
    with pytest.raises(InputError, match="is no folder"):
        model_files(folder / "b.glb")
    with pytest.raises(InputError, match="lies outside"):
        read_model(folder / "link.glb", folder)
