"""Programs of others that texture: well-behaved, failing, hanging and lying ones all end in a result."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from schemas.errors import InputError
from tasks.furniture import generate
from tasks.geometry.meshes import dump_glb, load_glb, surface_of
from tasks.texturing.commanded import PaintedTwin, TextureCommand, painted
from tasks.texturing.twin import textured_mesh
from tasks.texturing.unwrapping import XatlasUnwrapper, unwrapped
from tests.tasks.texturing.tools import program

IMAGE = np.tile(np.uint8([200, 40, 10]), (8, 8, 1))


@pytest.fixture(scope="module")
def data() -> bytes:
    return dump_glb(generate("stool", None, np.random.default_rng(2)).parts)


@pytest.fixture(scope="module")
def good(data: bytes) -> trimesh.Trimesh:
    surface = surface_of(load_glb(data))
    layout = unwrapped(XatlasUnwrapper(), surface.vertices, surface.faces)
    return textured_mesh(surface.vertices, layout, np.tile(np.uint8([9, 90, 200]), (64, 64, 1)), 90)


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where temporary files go: nothing may be left there."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield tmp_path
    assert list(folder.iterdir()) == []


def tool_that_leaves(folder: Path, left: bytes, more: str = "") -> tuple[str, ...]:
    (folder / "left.glb").write_bytes(left)
    body = f"import shutil\nshutil.copy({str(folder / 'left.glb')!r}, sys.argv[2])\n{more}"
    return program(folder, body), "{mesh}", "{out}"


def with_vertices(mesh: trimesh.Trimesh, vertices: np.ndarray) -> bytes:
    moved = mesh.copy()
    moved.vertices = vertices
    return dump_glb([moved], ["stool"])


def test_a_good_tool_is_taken_at_its_word(scratch: Path, data: bytes, good: trimesh.Trimesh) -> None:
    left = dump_glb([good], ["stool"])
    result = painted(TextureCommand(words=tool_that_leaves(scratch, left)), data)
    assert (result.problem, result.glb) == ("", left)
    assert result.figures is not None
    assert result.figures.overlap == 0
    assert result.seconds > 0


def test_what_a_tool_is_given(scratch: Path, data: bytes) -> None:
    """Its words one by one, with no shell between, and files that hold what they should."""
    prompt = "a {red} stool; rm -rf $HOME '{out}'"
    body = (
        "import json, base64, shutil\n"
        f"record = {{'words': sys.argv[1:], 'mesh': base64.b64encode(open(sys.argv[1], 'rb').read()).decode()}}\n"
        f"shutil.copy(sys.argv[2], {str(scratch / 'image.png')!r})\n"
        f"json.dump(record, open({str(scratch / 'record.json')!r}, 'w'))\n"
        "sys.exit('done looking')"
    )
    words = (program(scratch, body), "{mesh}", "{image}", "--prompt={prompt}", "{seed}", "{out}", "plain")
    result = painted(TextureCommand(words=words), data, IMAGE, prompt, 77)
    assert result.problem.endswith("ended with code 1: done looking")
    import base64
    import json

    record = json.loads((scratch / "record.json").read_text())
    mesh, image, said, seed, out, plain = record["words"]
    assert (said, seed, plain) == (f"--prompt={prompt}", "77", "plain")
    assert base64.b64decode(record["mesh"]) == data
    assert (np.asarray(Image.open(scratch / "image.png")) == IMAGE).all()
    assert {Path(mesh).name, Path(image).name, Path(out).name} == {"mesh.glb", "image.png", "out.glb"}


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("sys.stderr.write('Traceback\\nCUDA out of memory\\n'); sys.exit(3)", "ended with code 3: CUDA out of memory"),
        ("sys.exit(4)", "ended with code 4: it did not say why"),
        ("import os; os.abort()", "was ended by signal 6"),
        ("import time; time.sleep(1000)", "took longer than"),
        ("", r"out\.glb: file: cannot be read \(No such file or directory\); the program has to leave it"),
        ("open(sys.argv[2], 'w')", "does not begin with 'glTF'"),
        ("open(sys.argv[2], 'w').write('glTF and no more')", r"out\.glb: "),
        ("import os; os.mkfifo(sys.argv[2])", "is a pipe"),
        ("import os; os.mkdir(sys.argv[2])", "is a folder"),
        ("import os; os.symlink('/etc/hostname', sys.argv[2])", "is a link that leads out of its folder"),
        ("open(sys.argv[2], 'wb').truncate(2**40)", "bytes, at most"),
        ("import shutil; shutil.copy(sys.argv[1], sys.argv[2])", "has no texture of base colors"),
    ],
)
def test_a_tool_that_fails_or_leaves_no_texture(scratch: Path, data: bytes, body: str, words: str) -> None:
    command = TextureCommand(words=(program(scratch, body), "{mesh}", "{out}"), timeout_s=3.0 if "sleep" in body else 60.0)
    result = painted(command, data)
    assert result.glb == b""
    assert result.figures is None
    assert "\n" not in result.problem
    import re

    assert re.search(words, result.problem), result.problem


def test_a_tool_that_cannot_be_run(scratch: Path, data: bytes) -> None:
    assert painted(TextureCommand(), data) == PaintedTwin(problem="no program is named")
    assert "cannot be run" in painted(TextureCommand(words=("/nosuch/tool", "{mesh}", "{out}")), data).problem
    assert "cannot be run" in painted(TextureCommand(words=("/bin/true", "{mesh}", "{prompt}", "{out}")), data, prompt="a\0b").problem
    assert "wants an image" in painted(TextureCommand(words=("/bin/true", "{mesh}", "{image}", "{out}")), data).problem
    with pytest.raises(InputError, match=r"asset\.glb"):
        painted(TextureCommand(words=("/bin/true", "{mesh}", "{out}")), b"no asset")


def test_tools_that_lie_about_the_surface(scratch: Path, data: bytes, good: trimesh.Trimesh) -> None:
    vertices = np.asarray(good.vertices)
    reach = 0.005 * np.linalg.norm(np.ptp(vertices, axis=0))

    def problem(left: bytes) -> str:
        return painted(TextureCommand(words=tool_that_leaves(scratch, left)), data).problem

    assert problem(with_vertices(good, vertices + np.float64([0.5 * reach, 0, 0]))) == ""
    assert "has surface" in problem(with_vertices(good, vertices + np.float64([0, 0, 3 * reach])))
    assert "has surface" in problem(with_vertices(good, vertices * 1.5))
    assert "has surface" in problem(with_vertices(good, vertices[:, [1, 2, 0]]))
    half = good.copy()
    half.update_faces(np.asarray(good.triangles_center)[:, 2] > np.median(vertices[:, 2]))
    assert "lacks surface" in problem(dump_glb([half], ["stool"]))


def test_tools_that_lie_about_the_texture(scratch: Path, data: bytes, good: trimesh.Trimesh) -> None:
    def problem(change: str) -> str:
        mesh = good.copy()
        uv, material = np.array(mesh.visual.uv), mesh.visual.material
        if change == "stacked":
            uv = uv % 0.125
        elif change == "point":
            uv[:] = 0.5
        elif change == "nan":
            uv[3] = np.nan
        elif change == "plain":
            material = trimesh.visual.material.PBRMaterial(baseColorFactor=[10, 20, 30, 255])
        mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
        return painted(TextureCommand(words=tool_that_leaves(scratch, dump_glb([mesh], ["stool"]))), data).problem

    assert problem("none") == ""
    assert "shown in more than one place" in problem("stacked")
    assert "no triangle has an area" in problem("point")
    assert "has no place in the texture for every vertex" in problem("nan")
    assert "has no texture of base colors" in problem("plain")
    cut = dump_glb([good], ["stool"])
    assert painted(TextureCommand(words=tool_that_leaves(scratch, cut[:-2000])), data).problem != ""


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("tool", "{mesh}"), "words: must name {mesh}, which is read, and {out}, which is written"),
        (("tool", "{mesh}", "{out}", "{model}"), "words: {model} stands for nothing"),
        (("tool", "{}", "{mesh}", "{out}"), "words: {} stands for nothing"),
    ],
)
def test_words_that_make_no_sense_are_refused(words: tuple[str, ...], problem: str) -> None:
    with pytest.raises(ValueError, match=problem.replace("{", r"\{").replace("}", r"\}")):
        TextureCommand(words=words)
