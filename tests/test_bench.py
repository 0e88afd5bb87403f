"""The benchmark: rooms are disturbed as stated, faults that were planted are found, and the command prints every figure."""

from __future__ import annotations

import dataclasses
import io
import json
import os
from collections import defaultdict
from functools import cache
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from flows.bench import plain
from flows.bench.figures import figures, worst_cases
from flows.bench.measures import TOUCH_M, Measures
from flows.bench.perturbation import HUNG_MOST_M, LEAST_M, MOST_M, MOST_TURN, Thing, disturb
from flows.bench.rooms import BenchScene, Carried, disturbed_scene, generated_scene, scene_of_count
from flows.bench.tables import FIGURES, ONLY_OPTIMIZED, as_text, print_report
from flows.bench.verdicts import Results, Verdict, judge
from schemas.capture import Scene
from schemas.optimization import Placement
from tasks.furniture import generate
from tasks.furniture.furnishing import Furnishing
from tasks.furniture.rooms import ROOM_TYPES, FurnishedRoom, furnish
from tasks.optimization.mounting import mounting
from tasks.optimization.solids import Solid, shell_solids
from tasks.pieces import PieceConfig, pieces
from tasks.transforms import inverse, matrix, translation, yaw_of, yaw_pose
from tests.replicas import room_of
from tests.test_contacts import exact_depth
from tests.test_export_folder import built
from tests.test_pipeline import metascenes

SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])


@cache
def scene(index: int, seed: int = 0) -> BenchScene:
    return generated_scene(index, 20, seed)


def proposed(of: BenchScene) -> dict[str, np.ndarray]:
    return {row.instance_id: matrix(row.pose) for row in of.rows["selections"]}


@cache
def furnished(seed: int) -> tuple[tuple[Thing, ...], tuple[Solid, ...]]:
    """A furnished room as what the disturbance takes: things, and walls."""
    rng = np.random.default_rng(seed)
    made = furnish(ROOM_TYPES[seed % len(ROOM_TYPES)], rng, 25, 0.5)
    names = {item.name: f"{i:04d}" for i, item in enumerate(made.objects)}
    things = []
    for item in made.objects:
        name, parent = names[item.name], names.get(item.parent)
        let_in = mounting(item.category).kind in ("let_in", "covering")
        solid = Solid(name, pieces(item.parts, item.pieces, PieceConfig()).hulls)
        things.append(Thing(name, solid, item.pose, "on" if parent else item.parent, parent, let_in))
    return tuple(things), shell_solids(room_of(polygon=made.polygon.tolist()))


def deepest(one: Solid, pose: np.ndarray, other: Solid, there: np.ndarray) -> float:
    """Depth of the deepest pair of pieces of two solids, by every axis of every pair [m]."""
    first, second = one.placed(pose), other.placed(there)
    boxes = [[(h.vertices.min(axis=0), h.vertices.max(axis=0)) for h in hulls] for hulls in (first, second)]
    found = [exact_depth(a, b) for a, (al, ah) in zip(first, boxes[0], strict=True) for b, (bl, bh) in zip(second, boxes[1], strict=True)
             if (al < bh).all() and (bl < ah).all()]  # fmt: skip
    return max(found, default=0.0)


# disturbances


@given(seed=st.integers(0, 10**6), room=st.integers(0, 4))
@settings(max_examples=5, deadline=None)
def test_a_disturbance_does_what_it_says(seed: int, room: int) -> None:
    things, walls = furnished(room)
    poses, done = disturb(things, walls, np.random.default_rng(seed))
    by_name, wall_of = {t.name: t for t in things}, {w.name: w for w in walls}
    assert len({d.name for d in done}) == len(done), "a thing is disturbed once"
    kinds = {d.name: d for d in done}
    for thing in things:
        # as it would stand without a disturbance of its own
        carrier = by_name[thing.parent] if thing.parent else None
        along = poses[carrier.name] @ inverse(carrier.pose) @ thing.pose if carrier else thing.pose
        change = poses[thing.name] @ inverse(along)
        what = kinds.get(thing.name)
        if what is None:
            assert np.allclose(change, np.eye(4), atol=1e-9)
            continue
        assert not thing.is_let_in
        offset = poses[thing.name][:3, 3] - along[:3, 3]
        turn = abs(yaw_of(change))
        most = HUNG_MOST_M if thing.relation in ("wall", "ceiling") else MOST_M
        if what.kind == "turned":
            assert np.allclose(offset, 0.0, atol=1e-9)
            assert turn == pytest.approx(what.amount, abs=1e-9)
            assert what.amount <= MOST_TURN
            continue
        assert turn == pytest.approx(0.0, abs=1e-9)
        assert LEAST_M <= what.amount <= most
        if what.kind in ("raised", "sunk"):
            assert np.allclose(offset, [0.0, 0.0, what.amount if what.kind == "raised" else -what.amount], atol=1e-9)
        else:
            assert offset[2] == pytest.approx(0.0, abs=1e-9)
        if what.kind == "shifted":
            assert np.linalg.norm(offset) == pytest.approx(what.amount, abs=1e-9)
        if what.kind == "pushed":
            assert what.target is not None
            other, there = (wall_of[what.target], np.eye(4)) if what.target in wall_of else (by_name[what.target].solid, poses[what.target])
            assert deepest(thing.solid, poses[thing.name], other, there) == pytest.approx(what.amount, abs=1e-4)


def test_every_kind_of_disturbance_happens_and_pushes_meet_things_and_walls() -> None:
    done = [d for index in (2, 5, 7) for d in scene(index).disturbances]
    assert {d.kind for d in done} == {"pushed", "shifted", "turned", "raised", "sunk"}
    targets = [d.target for d in done if d.target]
    assert any(t.startswith("wall") for t in targets)
    assert any(not t.startswith("wall") for t in targets)


def test_what_was_raised_from_the_floor_floats_and_what_sank_is_in_it() -> None:
    seen = set()
    for index in (2, 5, 7):
        of = scene(index)
        blobs = {a.asset_id: a.mesh_blob for a in of.rows["assets"]}
        poses = proposed(of)
        for d in of.disturbances:
            if d.kind in ("raised", "sunk") and of.carried[d.name].relation == "floor":
                row = next(s for s in of.rows["selections"] if s.instance_id == d.name)
                mesh = trimesh.load_scene(io.BytesIO(of.blobs[blobs[row.asset_id]]), file_type="glb").to_mesh()
                bottom = float(mesh.bounds[0, 1]) * row.scale[2] + poses[d.name][2, 3]  # a GLB is +Y up
                assert bottom == pytest.approx(d.amount if d.kind == "raised" else -d.amount, abs=1e-6)
                seen.add(d.kind)
    assert seen == {"raised", "sunk"}


def test_the_same_seed_gives_the_same_rooms_and_another_gives_others() -> None:
    assert generated_scene(1, 20, 0).digest() == scene(1).digest()
    assert generated_scene(1, 20, 1).digest() != scene(1).digest()


def test_rooms_have_ten_to_eighty_things_of_every_kind_of_room_and_some_without_known_pieces() -> None:
    few, many = generated_scene(0, 50, 0), generated_scene(49, 50, 0)
    assert 8 <= len(few.rows["instances"]) <= 20
    assert 70 <= len(many.rows["instances"]) <= 95
    assert {generated_scene(i, 50, 0).rows["rooms"][0].room_type for i in range(5)} == set(ROOM_TYPES)
    assert any(asset.pieces_blob is None for i in (2, 5, 7, 8) for asset in scene(i).rows["assets"])
    assert any(row.scale != (1.0, 1.0, 1.0) for i in (2, 5, 7, 8) for row in scene(i).rows["selections"])


def test_a_scene_of_39_things_has_39() -> None:
    assert len(scene_of_count(39, 0).rows["instances"]) == 39


# planted faults


def at_rest(*objects: tuple[str, tuple[float, float, float], np.ndarray, str]) -> BenchScene:
    """A room of things (category, extents, pose, parent's name) that nothing disturbs."""
    rng = np.random.default_rng(3)
    items = []
    for index, (category, extents, pose, parent) in enumerate(objects):
        model = generate(category, extents, rng)
        items.append(Furnishing(f"{category}_{index}", category, model.parts, model.pieces, pose, extents, parent))
    room = FurnishedRoom("office", SQUARE, 2.6, [], items)
    return disturbed_scene("bench/planted", room, rng, plain_share=0.0, shares=())


def moved(of: BenchScene, name: str, offset: tuple[float, float, float]) -> BenchScene:
    """The same scene with one thing elsewhere from the start."""
    rows = [
        dataclasses.replace(s, pose=tuple((translation(offset) @ matrix(s.pose)).ravel().tolist())) if s.instance_id == name else s
        for s in of.rows["selections"]
    ]
    return dataclasses.replace(of, rows={**of.rows, "selections": rows})


def office() -> BenchScene:
    """A cabinet, a table with a box on it, and another box."""
    return at_rest(
        ("cabinet", (0.5, 0.8, 0.9), yaw_pose(0.0, [0.6, 1.0, 0.0]), "floor"),
        ("table", (0.8, 1.2, 0.75), yaw_pose(0.0, [2.4, 1.5, 0.0]), "floor"),
        ("box", (0.3, 0.3, 0.2), yaw_pose(0.0, [2.4, 1.5, 0.75]), "table_1"),
        ("box", (0.3, 0.3, 0.3), yaw_pose(0.0, [3.6, 0.5, 0.0]), "floor"),
    )


@cache
def verdicts(of: tuple[str, tuple[float, float, float]] | None = None, methods: tuple[str, ...] = ("paper",)) -> dict[str, Verdict]:
    made = office() if of is None else moved(office(), *of)
    return {v.state: v for v in judge(made, methods, 0, defaultdict(dict)).verdicts}


def test_nothing_is_wrong_with_a_room_at_rest() -> None:
    for state, v in verdicts(None, ("default",)).items():
        assert v.things == 4
        assert len(v.free) == 4
        for wrong in ("deep", "allowed", "unstable_1cm", "unstable_5cm", "floating", "outside", "lost_reported", "lost_silently",
                      "misjudged", "disagreeing", "fixed_wrongly"):  # fmt: skip
            assert not getattr(v, wrong), (state, wrong)
        assert max(far for _, far in v.displaced) < 1e-6, state


def test_a_planted_overlap_is_counted_with_its_depth() -> None:
    # the lone box goes 3 cm into the side of the table's top
    found = verdicts(("0003", (-0.65 - 0.03, 0.7, 0.5)))["input"]
    assert [(a, b) for a, b, _ in found.deep] == [("0001", "0003")]
    assert found.deep[0][2] == pytest.approx(0.03, abs=0.006)
    figure = figures([found])
    assert figure["deep_pairs"] == 1
    assert figure["deepest_m"] == found.deep[0][2]
    wall = verdicts(("0003", (0.28, 0.0, 0.0)))["input"]
    assert [b.rstrip("0123456789") for _, b, _ in wall.deep] == ["wall_"]
    assert wall.deep[0][2] == pytest.approx(0.03, abs=1e-6)
    assert wall.outside == (("0003", pytest.approx(0.03, abs=1e-5)),)


@pytest.mark.parametrize("gap", [0.008, 0.03, 0.3])
def test_a_planted_float_is_counted_with_its_gap_and_falls(gap: float) -> None:
    found = verdicts(("0003", (0.0, 0.0, gap)))["input"]
    assert found.floating == ((("0003", pytest.approx(gap, abs=1e-6)),) if gap > TOUCH_M else ())
    assert [name for name, _, _ in found.unstable_1cm] == (["0003"] if gap > 0.01 else [])
    assert [name for name, _, _ in found.unstable_5cm] == (["0003"] if gap > 0.05 else [])
    assert found.lost_silently == (("0003",) if gap > TOUCH_M else ())
    assert figures([found])["stable_1cm"] == (0.75 if gap > 0.01 else 1.0)


def test_a_changed_support_is_counted_and_told_apart_from_a_reported_one() -> None:
    of = office()
    # say that the box on the table stood on the cabinet
    told = dataclasses.replace(of, carried={**of.carried, "0002": Carried("on", "0000")})
    result = judge(told, ("paper",), 0, defaultdict(dict))
    v = {one.state: one for one in result.verdicts}["paper"]
    assert v.lost_silently == v.misjudged == ("0002",)
    assert figures([v])["supports_kept"] == 3
    assert worst_cases([result], "paper")[0]["instances"] == ["0002"]
    on_floor = dataclasses.replace(of, carried={**of.carried, "0003": Carried("wall", None)})
    v = {one.state: one for one in judge(on_floor, ("paper",), 0, defaultdict(dict)).verdicts}["paper"]
    assert v.lost_silently == ("0003",), "it hangs on no wall"


def test_a_rug_under_a_thing_is_as_good_as_the_floor() -> None:
    of = at_rest(
        ("rug", (2.0, 1.5, 0.01), yaw_pose(0.0, [2.0, 1.5, 0.0]), "floor"),
        ("box", (0.4, 0.4, 0.4), yaw_pose(0.0, [2.0, 1.5, 0.01]), "floor"),
    )
    v = {one.state: one for one in judge(of, ("paper",), 0, defaultdict(dict)).verdicts}["input"]
    assert not v.lost_silently
    assert not v.floating


@given(yaw=st.floats(-3, 3), gap=st.floats(-0.02, 0.4), x=st.floats(-0.2, 0.2))
@settings(max_examples=25, deadline=None)
def test_gaps_are_measured_at_any_turn_and_in_any_order(yaw: float, gap: float, x: float) -> None:
    top, thing = trimesh.creation.box((1.0, 1.0, 0.04)), trimesh.creation.box((0.2, 0.3, 0.1))
    solids = [Solid(name, pieces([mesh], [mesh], PieceConfig()).hulls) for name, mesh in (("0000", top), ("0001", thing))]
    poses = {"0000": yaw_pose(0.3, [1, 2, 0.7]), "0001": yaw_pose(yaw, [1 + x, 2, 0.7 + 0.02 + 0.05 + gap])}
    for ordered in (solids, solids[::-1]):
        posed = Measures(ordered, {}, SQUARE, 2.5).at(poses)
        gaps = posed.gaps("0001")
        assert gaps["0000"] == pytest.approx(gap, abs=1e-5)
        assert gaps["floor"] == pytest.approx(0.72 + gap, abs=1e-9)
        assert posed.gaps("0000") == {"floor": pytest.approx(0.68, abs=1e-9)}


def test_judging_twice_gives_the_same_but_for_the_times() -> None:
    def timeless(results: Results) -> tuple[Verdict, ...]:
        return tuple(dataclasses.replace(v, seconds=0.0) for v in results.verdicts)

    small = disturbed_scene("bench/small", furnish("office", np.random.default_rng(5), 10), np.random.default_rng(6), plain_share=0.0)
    first, second = (judge(small, ("paper", "default"), 1, defaultdict(dict)) for _ in range(2))
    assert timeless(first) == timeless(second)
    assert {v.state for v in first.verdicts} == {"drawn", "input", "paper", "default"}
    assert any(far > 0 for _, far in first.verdicts[-1].displaced)


# the command


@pytest.fixture(scope="module")
def report() -> dict[str, Any]:
    done = metascenes({**os.environ, "OMP_NUM_THREADS": "1"}, "bench", "optimization", "--rooms", "1", "--json", "--processes", "2")
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


def test_the_command_prints_every_figure(report: dict[str, Any]) -> None:
    assert list(report["states"]) == ["drawn", "input", "paper", "default"]
    for state in report["states"].values():
        assert {key for key, _, _ in FIGURES} <= set(state)
        assert state["things"] == len(generated_scene(0, 1, 0).rows["instances"])
    assert report["states"]["input"]["displacement_mean_m"] == 0
    assert report["states"]["input"]["deep_pairs"] > report["states"]["drawn"]["deep_pairs"]
    assert report["disturbances"] == len(generated_scene(0, 1, 0).disturbances)
    assert set(report["moves"]["seconds_per_move"]) == {"39", "100", "300", "1000"}
    assert report["moves"]["is_same"]
    assert report["moves"]["largest_difference_m3"] <= 1e-9
    assert report["scene"]["count"] == 39
    assert report["scene"]["default"] > 0
    assert report["chains"]["is_same"]
    assert {row["method"] for row in report["pieces"]} == {"hulls", "coacd"}
    assert {"processor", "cores", "python", "versions"} <= set(report["machine"])
    assert len(report["goals"]) == 8


def test_the_report_renders_as_tables(report: dict[str, Any]) -> None:
    out = io.StringIO()
    print_report(report, Console(file=out, width=140))
    said = out.getvalue()
    for key, words, unit in FIGURES:
        line = next(line for line in said.splitlines() if line.strip().startswith(words))
        for name, state in report["states"].items():
            if not (key in ONLY_OPTIMIZED and name in ("drawn", "input")):
                assert as_text(state[key], unit) in line
    for goal in report["goals"]:
        assert goal["goal"] in said
    assert all(case["scene_id"] in said for case in report["worst"])


def test_scenes_of_a_lake_are_read_as_the_stage_reads_them(tmp_path_factory: pytest.TempPathFactory) -> None:
    from flows.bench.optimization import BenchConfig, jobs_of, judge_job
    from warehouse.lake import Lake

    address = str(built(tmp_path_factory)[2])
    reader = Lake.open(address).snapshot()
    jobs = jobs_of(BenchConfig(("paper", "default"), lake=address), {})
    assert [job.scene_id for job in jobs] == [row.scene_id for row in reader.rows(Scene)]
    for job in jobs:
        result = judge_job(job)
        assert [v.state for v in result.verdicts] == ["input", "paper", "default"]
        rows = {row.instance_id: row for row in reader.rows(Placement, job.scene_id)}
        assert {name for name, _ in result.verdicts[-1].displaced} == set(rows)
        for name, far in result.verdicts[-1].displaced:
            assert far == pytest.approx(rows[name].displacement_m, abs=1e-9), "the run gave what the benchmark measures"


def test_moves_alone_are_timed_without_rooms() -> None:
    done = metascenes({**os.environ}, "bench", "optimization", "--moves-only", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert "states" not in found
    assert found["moves"]["speedup"] > 1
    assert found["moves"]["moves"] == plain.compare(39, 0)["moves"]


def test_an_unknown_method_and_a_missing_lake_are_refused_in_one_line(tmp_path: Any) -> None:
    done = metascenes({**os.environ}, "bench", "optimization", "--methods", "magic")
    assert done.returncode == 2
    assert "'magic' is none of paper, default" in done.stderr
    done = metascenes({**os.environ}, "bench", "optimization", "--lake", tmp_path / "none")
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
