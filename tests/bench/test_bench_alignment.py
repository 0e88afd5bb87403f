"""The benchmark of the alignment: truths are what they say, symmetry is found by nothing but shape, and every method is in the tables."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from rich.console import Console

from bench.alignment.objects import PosedObject, camera_made, generated, same_turns, scanned, whole
from bench.alignment.report import SETS, Variant, errors, variants
from bench.alignment.tables import print_alignment
from flows.commands.bench import command
from schemas.families.alignment_methods import ALIGNMENT_METHODS
from tasks.alignment import AlignmentConfig
from tasks.geometry.meshes import Surface, canonical, surface_of
from tests.tasks.selection.rooms import cabinet, chair, part


def at_rest(surface: Surface, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> PosedObject:
    return PosedObject("object", surface, 0.4, np.array([1.0, 2.0, 0.0]), np.array(scale))


def round_table() -> list[trimesh.Trimesh]:
    top, foot = trimesh.creation.cylinder(0.5, 0.05, sections=64), trimesh.creation.cylinder(0.05, 0.7, sections=64)
    top.apply_translation((0, 0, 0.72))
    foot.apply_translation((0, 0, 0.35))
    return [top, foot]


@pytest.mark.parametrize(
    ("parts", "scale", "turns"),
    [
        (chair(), (1, 1, 1), [0]),
        (cabinet(), (1, 1, 1), [0, 90, 180, 270]),
        (cabinet(), (1.2, 0.9, 1), [0, 90, 180, 270]),
        ([part((0.4, 0.9, 0.5), (0, 0, 0.25))], (1, 1, 1), [0, 90, 180, 270]),
        ([part((0.4, 0.9, 0.5), (0, 0, 0.25)), part((0.3, 0.1, 0.3), (0, 0, 0.65))], (1, 1, 1), [0, 180]),
        (round_table(), (1, 1, 1), None),
    ],
    ids=["chair", "cube", "stretched cube", "box", "box with a bar", "round"],
)
def test_turns_after_which_an_object_is_the_same(parts: list, scale: tuple, turns: list[int] | None) -> None:
    found = same_turns(at_rest(surface_of(canonical(parts)), scale), np.random.default_rng(0))
    assert (None if found is None else np.degrees(found).round().tolist()) == turns


def test_what_a_photo_makes_is_where_the_object_is() -> None:
    posed = generated(3, 0)
    seen = scanned(posed, np.random.default_rng(0), AlignmentConfig())
    assert seen is not None
    made = camera_made(posed, seen)
    assert np.allclose(made.placed.vertices, posed.placed.vertices, atol=1e-9)
    assert np.ptp(made.scale) == 0.0


def test_a_scan_is_on_the_object_and_of_one_side() -> None:
    posed = at_rest(surface_of([trimesh.creation.box((0.8, 0.8, 0.8)).apply_translation((0, 0, 0.4))]))
    seen = scanned(posed, np.random.default_rng(2), AlignmentConfig())
    assert seen is not None
    assert seen.target.sight is not None
    points, sight = seen.target.points, seen.target.sight
    away = np.max(np.abs(points - [0.0, 0.0, 0.4]), axis=1)
    assert np.quantile(np.abs(away - 0.4), 0.9) < 0.02
    assert (points - [0, 0, 0.4])[:, :2].mean(axis=0) @ sight.toward[:2] > 0.05


def test_a_whole_scan_of_what_is_the_same_after_no_turn_leaves_ours_no_error() -> None:
    posed = at_rest(surface_of(canonical(chair())))
    ours: Variant = variants()[0]
    rng = np.random.default_rng(0)
    (row,) = errors(SETS[3], posed, whole(posed, rng, AlignmentConfig()), [ours], rng)
    assert row.turns == 1
    assert row.yaw_degrees is not None
    assert row.yaw_degrees < 1.0
    assert (row.position_m < 0.01, row.scale < 0.02, row.chamfer_m < 0.01) == (True, True, True)


@pytest.mark.slow
@pytest.mark.whole
def test_the_command_measures_every_method_and_says_what_it_lacks(tmp_path: Path) -> None:
    done = CliRunner().invoke(command, ["alignment", "--objects", "2", "--processes", "1", "--json", "--realdata", str(tmp_path)])
    report = json.loads(done.output[done.output.index("{") :])
    measured = {row["method"].split(",")[0].split(" ")[0] for row in report["figures"] if row["set"] == SETS[0]}
    assert measured == set(ALIGNMENT_METHODS)
    assert report["without"] == "models by others: none below --realdata"
    assert done.exit_code == int(any(goal["met"] is False for goal in report["goals"]))
    shown = io.StringIO()
    print_alignment(report, Console(file=shown, width=140))
    for row in report["figures"]:
        assert row["method"] in shown.getvalue()
