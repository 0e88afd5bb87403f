"""Unwrapping: the same surface comes back, laid out; what goes wrong in a process of its own is said."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.furniture import generate
from tasks.geometry.meshes import load_glb, surface_of
from tasks.texturing.charts import chart_figures
from tasks.texturing.unwrapping import SmartUvUnwrapper, Unwrapped, Unwrapper, XatlasUnwrapper, unwrapped
from tests.tasks.calls.hanging import assert_all_end
from tests.tasks.texturing.tools import program

XATLAS = XatlasUnwrapper()


@pytest.fixture(params=["xatlas", pytest.param("smart_uv", marks=pytest.mark.slow)])
def unwrapper(request: pytest.FixtureRequest) -> Unwrapper:
    """Either tool; Smart UV where METASCENES_BPY names an interpreter that has bpy, or a blender binary."""
    if request.param == "xatlas":
        return XATLAS
    named = os.environ.get("METASCENES_BPY", "")
    if not named or not shutil.which(named):
        pytest.skip("METASCENES_BPY names no interpreter with bpy, and no blender")
    return SmartUvUnwrapper(program=named)


def surface(category: str) -> tuple[np.ndarray, np.ndarray]:
    merged = surface_of(generate(category, None, np.random.default_rng(1)).parts)
    return merged.vertices, merged.faces


def assert_same_surface(layout: Unwrapped, vertices: np.ndarray, faces: np.ndarray) -> None:
    assert (layout.vertices[layout.faces] == vertices[faces]).all(), "bit for bit, corner by corner"
    assert (layout.source[layout.faces] == faces).all()
    assert (layout.vertices == vertices[layout.source]).all()
    assert len(np.unique(layout.faces)) == len(layout.source), "no vertex is left over"
    rows = np.column_stack([layout.source, layout.uv])
    assert len(np.unique(rows, axis=0)) == len(rows), "no vertex is split without need"
    assert (layout.uv.astype(np.float32) == layout.uv).all()
    assert layout.uv.min() >= 0.0
    assert layout.uv.max() <= 1.0


@pytest.mark.parametrize("category", ["chair", "mug", "bookshelf", "plant"])
def test_the_same_surface_comes_back_laid_out(unwrapper: Unwrapper, category: str) -> None:
    vertices, faces = surface(category)
    layout = unwrapped(unwrapper, vertices, faces)
    assert_same_surface(layout, vertices, faces)
    figures = chart_figures(layout.vertices, layout.faces, layout.uv)
    assert figures.outside == 0
    assert figures.collapsed <= 0.01 * len(faces)
    assert figures.stretch_l2 < 1.2
    assert layout.seconds > 0
    if unwrapper.kind == "xatlas":
        assert figures.overlap == 0
        assert layout.by.startswith("xatlas 0.")
    else:
        assert layout.by.startswith("Blender ")
    again = unwrapped(unwrapper, vertices, faces)
    assert again.uv.tobytes() == layout.uv.tobytes()
    assert again.faces.tobytes() == layout.faces.tobytes()


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=8, deadline=None)
def test_any_soup_comes_back_as_it_was(seed: int) -> None:
    """Triangles with twins, without area, and of all sizes."""
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(12, 3)) * 10 ** rng.uniform(-2, 1)
    faces = rng.integers(0, 12, (20, 3))
    faces = np.concatenate([faces, faces[:4], faces[:3, ::-1]])
    layout = unwrapped(XATLAS, vertices, faces)
    assert_same_surface(layout, vertices, faces)
    assert chart_figures(layout.vertices, layout.faces, layout.uv, 256).overlap < 0.01


def test_a_surface_with_split_vertices_is_laid_out_as_a_whole(unwrapper: Unwrapper) -> None:
    ball = trimesh.creation.icosphere(2)
    whole = unwrapped(unwrapper, ball.vertices, ball.faces)
    soup = np.asarray(ball.vertices)[ball.faces].reshape(-1, 3)
    split = unwrapped(unwrapper, soup, np.arange(len(soup)).reshape(-1, 3))
    assert len(split.source) <= len(soup)
    one, other = (chart_figures(of.vertices, of.faces, of.uv) for of in (whole, split))
    assert one.charts <= 12
    assert abs(one.charts - other.charts) <= 2  # in which order vertices come decides where charts begin


@pytest.mark.parametrize("scale", [1e-3, 1.0, 30.0])
def test_size_does_not_matter(scale: float) -> None:
    vertices, faces = surface("bowl")
    layout = unwrapped(XATLAS, vertices * scale, faces)
    figures = chart_figures(layout.vertices, layout.faces, layout.uv)
    assert figures.collapsed == 0
    if scale >= 1:  # welding takes thousandths of a bowl for finer than it is
        plain = unwrapped(XATLAS, vertices, faces)
        assert figures.charts == chart_figures(plain.vertices, plain.faces, plain.uv).charts


def test_two_sides_of_a_sheet_have_places_of_their_own(unwrapper: Unwrapper) -> None:
    uv = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    first = (np.arange(4)[:, None] * 5 + np.arange(4)).ravel()
    front = np.concatenate([np.stack([first, first + 1, first + 6], 1), np.stack([first, first + 6, first + 5], 1)])
    vertices, faces = np.column_stack([uv, np.zeros(25)]), np.concatenate([front, front[:, ::-1]])
    layout = unwrapped(unwrapper, vertices, faces)
    assert_same_surface(layout, vertices, faces)
    assert chart_figures(layout.vertices, layout.faces, layout.uv).overlap == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [("many", "has 12 faces, more than 11"), ("nan", "not finite"), ("none", "has no faces"), ("flat", "no triangle with an area")],
)
def test_what_cannot_be_unwrapped_says_why(change: str, words: str) -> None:
    box = trimesh.creation.box()
    vertices, faces = np.array(box.vertices), np.array(box.faces)
    if change == "nan":
        vertices[2, 1] = np.nan
    elif change == "none":
        faces = faces[:0]
    elif change == "flat":
        vertices[:, 1:] = 0.0
    with pytest.raises(InputError, match=words):
        unwrapped(XatlasUnwrapper(max_faces=11 if change == "many" else 100), vertices, faces)


READS = """
import numpy, pathlib, os, time
folder = pathlib.Path(sys.argv[-1])
assert sys.argv[1] == "-I" and sys.argv[2].endswith("smart_uv_script.py")
faces = numpy.fromfile(folder / "faces.i8", dtype="<i8").reshape(-1, 3)
at = numpy.fromfile(folder / "vertices.f8", dtype="<f8").reshape(-1, 3)[faces]
limit, margin = numpy.fromfile(folder / "settings.f8", dtype="<f8")
places = at[..., :2].astype("<f4")
"""

WRITES = READS + "places.tofile(folder / 'uv.f4'); (folder / 'version.txt').write_text(f'{limit:.4f} {margin}')"


def quad() -> tuple[np.ndarray, np.ndarray]:
    return np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0.5], [0, 1, 0.5]]), np.array([[0, 1, 2], [0, 2, 3]])


def test_files_go_to_a_program_and_come_back(tmp_path: Path) -> None:
    layout = unwrapped(SmartUvUnwrapper(program=program(tmp_path, WRITES)), *quad())
    assert layout.by == "Blender 1.1519 0.004 Smart UV"
    assert (layout.uv == layout.vertices[:, :2]).all()
    assert len(layout.uv) == 4


def test_a_blender_binary_gets_its_own_arguments(tmp_path: Path) -> None:
    body = "open(sys.argv[-1] + '/said', 'w'); sys.exit(' '.join(sys.argv[1:5]) + ' | ' + sys.argv[7])"
    with pytest.raises(InputError, match=r"--background --factory-startup --python-exit-code 3 \| --"):
        unwrapped(SmartUvUnwrapper(program=program(tmp_path, body, "blender-4.5")), *quad())


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (
            "print('noise', file=sys.stderr); sys.exit('ModuleNotFoundError: No module named bpy')",
            r"ended with code 1: ModuleNotFoundError",
        ),
        ("import os; os.kill(os.getpid(), 9)", "was ended by signal 9"),
        ("", r"uv\.f4 of Smart UV: file: cannot be read"),
        (READS + "places[:1].tofile(folder / 'uv.f4'); (folder / 'version.txt').touch()", "left 24 bytes for 2 faces"),
        (READS + "(places / 0).tofile(folder / 'uv.f4'); (folder / 'version.txt').touch()", "not finite"),
        (READS + "os.mkfifo(folder / 'uv.f4')", "is a pipe"),
        (READS + "(folder / 'uv.f4').write_bytes(bytes(1000))", "is 1000 bytes, at most 48"),
    ],
)
def test_a_program_that_fails_is_one_line(tmp_path: Path, body: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as raised:
        unwrapped(SmartUvUnwrapper(program=program(tmp_path, body)), *quad())
    assert "\n" not in str(raised.value)


def test_no_program_is_said(tmp_path: Path) -> None:
    for named in ("", str(tmp_path / "nosuch"), str(tmp_path)):
        with pytest.raises(InputError, match="is no program that can be run; name an interpreter that has bpy"):
            unwrapped(SmartUvUnwrapper(program=named), *quad())


def test_a_program_that_hangs_is_ended_with_all_it_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))

    def end(body: str, seconds: float) -> None:
        with pytest.raises(InputError, match=rf"took longer than {seconds:.0f} s; raise timeout_s"):
            unwrapped(SmartUvUnwrapper(program=program(tmp_path, body), timeout_s=seconds), *quad())
        assert list(scratch.iterdir()) == []

    assert_all_end(tmp_path, end)


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["aws_ChairA_01", "aws_NightStand_01"])
def test_models_by_others_come_back_as_they_were(unwrapper: Unwrapper, realdata: Callable[[str], Path], name: str) -> None:
    merged = surface_of(load_glb((realdata("assets") / f"{name}.glb").read_bytes()))
    layout = unwrapped(unwrapper, merged.vertices, merged.faces)
    assert_same_surface(layout, merged.vertices, merged.faces)
    figures = chart_figures(layout.vertices, layout.faces, layout.uv)
    assert figures.charts < 0.25 * len(merged.faces)
    assert figures.overlap < 0.05
