"""The benchmark of scans without labels: scores against a slow count, generated frames, packed clouds, and a small run of it."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from bench.capture.drawn import drawings, read_drawing
from bench.capture.former import has_former
from bench.capture.frames import KnownFrame, figures_of, former_figures, frame_goals, pose_over, truth_of
from bench.capture.recorded import cloud_view, recorded_view, truth_of_drawing, unpacked
from bench.capture.tables import print_capture
from bench.capture.tabletops import REST, SUPPORT, TabletopFrame, tabletop_frame
from bench.capture.truth import LEAST_PIXELS, NOTHING, UNKNOWN, FrameTruth, frame_score
from flows.commands.bench import command
from schemas.errors import InputError
from tasks.capture.segmentation.planes import Plane

PARTS = np.repeat(np.repeat(np.arange(4).reshape(2, 2), 30, axis=0), 40, axis=1)
"""Four rectangles of 1,200 pixels."""


@pytest.fixture(scope="module")
def table() -> TabletopFrame:
    return tabletop_frame(5, 30, 1000)


def scored(owner: np.ndarray, found: np.ndarray, supports: frozenset[int] = frozenset()) -> tuple[int, ...]:
    score = frame_score(FrameTruth(owner, supports), found, np.ones(owner.shape, dtype=bool))
    return score.objects, score.regions, score.matched, score.matched_well, score.in_pieces, score.shared


def test_what_is_found_as_it_is_has_full_marks_whatever_the_numbers() -> None:
    assert scored(PARTS, PARTS) == (4, 4, 4, 4, 0, 0)
    assert scored(PARTS, 3 - PARTS) == (4, 4, 4, 4, 0, 0)


def test_pieces_and_merged_things_are_counted() -> None:
    assert scored(PARTS, np.where(PARTS < 2, 0, PARTS)) == (4, 3, 3, 2, 0, 2), "a region of two alike is half of one of them"
    halves = np.where((PARTS == 0) & (np.arange(80) < 20), 4, PARTS)
    assert scored(PARTS, halves) == (4, 5, 4, 3, 1, 0), "one of its halves is enough, and no good one"
    assert scored(PARTS, np.full_like(PARTS, -1)) == (4, 0, 0, 0, 0, 0)


def test_what_nobody_labeled_supports_and_specks_are_neither_right_nor_wrong() -> None:
    assert scored(np.where(PARTS == 3, UNKNOWN, PARTS), PARTS) == (3, 3, 3, 3, 0, 0)
    assert scored(np.where(PARTS == 3, NOTHING, PARTS), PARTS) == (3, 4, 3, 3, 0, 0), "what is known to be wall is no thing"
    assert scored(PARTS, PARTS, frozenset({3})) == (3, 3, 3, 3, 0, 0)
    speck = np.full_like(PARTS, UNKNOWN)
    speck.ravel()[: LEAST_PIXELS - 1] = 0
    assert scored(speck, np.where(speck == 0, 0, -1)) == (0, 0, 0, 0, 0, 0)


@given(st.integers(0, 2**32 - 1))
def test_matches_are_those_of_a_slow_count(seed: int) -> None:
    """With an overlap above a half no two regions can have one object: whoever has it is its match."""
    rng = np.random.default_rng(seed)
    found = np.where(rng.random(PARTS.shape) < rng.random(), PARTS, rng.integers(-1, 6, PARTS.shape))
    slow = sum(any(((i == PARTS) & (found == j)).sum() >= 0.5 * ((i == PARTS) | (found == j)).sum() for j in range(6)) for i in range(4))
    assert scored(PARTS, found)[2] == slow


def test_a_generated_frame_knows_its_pixels(table: TabletopFrame) -> None:
    """Depth of the table's top is the table's, and no object's pixel lies below it."""
    points = table.view.points()
    has_depth = table.view.depth > 0
    top = points[has_depth & (table.owner == SUPPORT)][:, 2]
    assert abs(np.median(top) - table.height_m) < 0.001
    things = points[has_depth & (table.owner >= 0)][:, 2]
    assert np.quantile(things, 0.01) > table.height_m - 0.01
    assert np.degrees(table.pitch) == pytest.approx(28.3 + 0.8, abs=1.7)
    assert set(np.unique(table.owner)) <= {REST, SUPPORT, *range(len(table.words))}
    again = tabletop_frame(5, 30, 1000)
    assert again.view.depth.tobytes() == table.view.depth.tobytes()
    assert again.view.color.tobytes() == table.view.color.tobytes()


def test_figures_of_the_truth_meet_all_goals(table: TabletopFrame) -> None:
    frame = KnownFrame(table.view, truth_of(table), table)
    up = table.view.pose[2, :3]
    level = pose_over(Plane(up, float(table.view.pose[2, 3] - table.height_m)))
    right = figures_of("generated", "now", [frame], [np.where(table.owner >= 0, table.owner, -1)], [level], [0.5])
    assert all(row["met"] for row in frame_goals([right]))
    assert (right.level, right.score.f1) == (1, 1.0)
    lifted = level.copy()
    lifted[2, 3] += 0.02
    wrong = figures_of("generated", "now", [frame], [np.full(table.owner.shape, -1)], [lifted], [1.5])
    assert not any(row["met"] for row in frame_goals([wrong]))
    former = figures_of("generated", "before", [frame], [np.full(table.owner.shape, -1)], [lifted], [1.5])
    assert frame_goals([former]) == [], "what was stands beside, and is held against nothing"


def packed(data: bytes) -> bytes:
    """LZF of literal runs alone, and of a reference for every run of one byte."""
    out, at = bytearray(), 0
    while at < len(data):
        run = 1
        while at + run < len(data) and data[at + run] == data[at] and run < 265:
            run += 1
        out += bytes([0, data[at]])
        rest, at = run - 1, at + run
        if rest >= 9:
            out += bytes([7 << 5, rest - 9, 0])
        elif rest >= 3:
            out += bytes([(rest - 2) << 5, 0])
        else:
            out += bytes([0, data[at - 1]]) * rest
    return bytes(out)


@given(st.lists(st.tuples(st.integers(0, 255), st.integers(1, 400)), max_size=20))
def test_packed_bytes_come_out_as_they_went_in(runs: list[tuple[int, int]]) -> None:
    data = b"".join(bytes([value]) * count for value, count in runs)
    assert unpacked(packed(data), len(data)) == data
    for size in {len(data) + 1, max(0, len(data) - 1)} - {len(data)}:
        with pytest.raises(ValueError, match="than it says"):
            unpacked(packed(data), size)


def test_a_cloud_is_a_frame_with_one_lens(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    xyz, code = rng.normal(size=(3, 4, 6)).astype("<f4"), rng.integers(0, 1 << 24, (4, 6)).astype("<u4")
    xyz[:, 0, 0] = np.nan
    columns = np.concatenate([xyz.reshape(3, -1), code.reshape(1, -1).view("<f4")])
    head = "# PCD\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 6\nHEIGHT 4\nPOINTS 24\n"
    small = packed(columns.tobytes())
    (tmp_path / "a.pcd").write_bytes(f"{head}DATA binary\n".encode() + columns.T.tobytes())
    (tmp_path / "b.pcd").write_bytes(f"{head}DATA binary_compressed\n".encode() + struct.pack("<II", len(small), columns.nbytes) + small)
    for name in ("a.pcd", "b.pcd"):
        view = cloud_view(tmp_path / name)
        assert (view.depth == np.nan_to_num(np.abs(xyz[2]))).all()
        assert (view.color @ [1 << 16, 1 << 8, 1] == code).all()
    for broken in (b"", head.encode(), f"{head}DATA binary_compressed\n".encode() + struct.pack("<II", 9, 384) + b"\xff" * 9):
        (tmp_path / "c.pcd").write_bytes(broken)
        with pytest.raises(InputError, match=r"^c.pcd: DATA: is no organized cloud"):
            cloud_view(tmp_path / "c.pcd")


def test_every_drawing_has_its_frame(realdata: Callable[[str], Path]) -> None:
    root = realdata("rgbd_pcl_office").parent
    for path in drawings():
        drawing = read_drawing(path)
        view, truth = recorded_view(drawing, root), truth_of_drawing(drawing)
        assert view.depth.shape == truth.owner.shape == (drawing.size[1], drawing.size[0])
        counted = [(view.depth[truth.owner == number] > 0).mean() for number in range(len(drawing.objects))]
        assert np.median(counted) > 0.5, f"{path.name}: objects are where depth is"


@pytest.mark.slow
@pytest.mark.whole
def test_the_former_code_runs_and_finds_little_of_a_table(table: TabletopFrame) -> None:
    if not has_former():
        pytest.skip("the former code is not in the history here")
    figures = former_figures("generated", [KnownFrame(table.view, truth_of(table), table)])
    assert figures.seconds > 0
    assert figures.score.objects == 5
    assert figures.score.f1 < 0.5


@pytest.mark.whole
def test_a_small_run_prints_rows_and_goals() -> None:
    result = CliRunner().invoke(
        command, ["capture", "--parts", "frames", "--frames", "2", "--seed", "1000", "--json"], env={"METASCENES_REALDATA": ""}
    )
    assert result.exit_code in (0, 1), result.output
    report = json.loads(result.output)
    rows = {row["code"]: row for row in report["parts"]["frames"]["rows"]}
    assert rows["now"]["frames"] == 2
    assert rows["now"]["f1"] > 0.5
    assert rows["now"]["level"] == 2
    text = io.StringIO()
    print_capture(report, Console(file=text, width=140))
    assert "generated: F1 at IoU 0.5" in text.getvalue()
