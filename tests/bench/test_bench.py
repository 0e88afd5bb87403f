"""The benchmark: rooms are disturbed as stated, faults that were planted are found, and the command prints every figure."""

from __future__ import annotations

import dataclasses
import io
import json
import math
import os
from collections import defaultdict
from functools import cache
from typing import Any

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from scipy.spatial import ConvexHull

from bench.optimization import plain
from bench.optimization.depths import Polyhedron, depth_of_objects, depth_of_pair, disagreeing
from bench.optimization.figures import figures, goals, worst_cases
from bench.optimization.measures import TOUCH_M, Measures
from bench.optimization.reports import reported_losses, reported_outside
from bench.optimization.tables import FIGURES, ONLY_OPTIMIZED, print_report
from bench.optimization.verdicts import SceneVerdicts, Verdict, config_of, context_of, judge, optimized
from bench.perturbation import HUNG_MOST_M, LEAST_M, MOST_M, MOST_TURN, PerturbedObject, disturb
from bench.rooms import BenchScene, Carried, disturbed_scene, generated_scene, scene_of_count
from bench.tables import as_text
from flows.commands.bench import command
from schemas.capture import Scene
from schemas.optimization import Placement
from tasks.furniture import generate
from tasks.furniture.furnishing import Furnishing
from tasks.furniture.rooms import ROOM_TYPES, FurnishedRoom, furnish
from tasks.geometry.pieces import PieceConfig, pieces
from tasks.geometry.transforms import inverse, matrix, translation, yaw_of, yaw_pose
from tasks.mounting import mounting
from tasks.optimization.contacts import Colliders
from tasks.optimization.solids import ConvexParts, shell_solids
from tasks.stage import Blobs, Outcome
from tests.flows.outputs.test_export_folder import built
from tests.replicas import room_of
from tests.tasks.optimization.test_contacts import exact_depth
from tests.test_pipeline import metascenes

pytestmark = pytest.mark.whole

SQUARE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])


@cache
def scene(index: int, seed: int = 0) -> BenchScene:
    return generated_scene(index, 20, seed)


def proposed(of: BenchScene) -> dict[str, np.ndarray]:
    return {row.instance_id: matrix(row.pose) for row in of.rows["selections"]}


@cache
def furnished(seed: int) -> tuple[tuple[PerturbedObject, ...], tuple[ConvexParts, ...]]:
    """A furnished room as what the disturbance takes: objects, and walls."""
    rng = np.random.default_rng(seed)
    made = furnish(ROOM_TYPES[seed % len(ROOM_TYPES)], rng, 25, 0.5)
    names = {item.name: f"{i:04d}" for i, item in enumerate(made.objects)}
    objects = []
    for item in made.objects:
        name, parent = names[item.name], names.get(item.parent)
        let_in = mounting(item.category).kind in ("let_in", "covering")
        solid = ConvexParts(name, pieces(item.parts, item.pieces, PieceConfig()).hulls)
        objects.append(PerturbedObject(name, solid, item.pose, "on" if parent else item.parent, parent, let_in))
    return tuple(objects), shell_solids(room_of(polygon=made.polygon.tolist()))


def deepest(one: ConvexParts, pose: np.ndarray, other: ConvexParts, there: np.ndarray) -> float:
    """Depth of the deepest pair of pieces of two solids, by every axis of every pair [m]."""
    first, second = one.placed(pose), other.placed(there)
    boxes = [[(h.vertices.min(axis=0), h.vertices.max(axis=0)) for h in hulls] for hulls in (first, second)]
    found = [exact_depth(a, b) for a, (al, ah) in zip(first, boxes[0], strict=True) for b, (bl, bh) in zip(second, boxes[1], strict=True)
             if (al < bh).all() and (bl < ah).all()]  # fmt: skip
    return max(found, default=0.0)


# disturbances


@pytest.mark.slow
@given(seed=st.integers(0, 10**6), room=st.integers(0, 4))
@settings(max_examples=5, deadline=None)
def test_a_disturbance_does_what_it_says(seed: int, room: int) -> None:
    objects, walls = furnished(room)
    poses, done = disturb(objects, walls, np.random.default_rng(seed))
    by_name, wall_of = {t.name: t for t in objects}, {w.name: w for w in walls}
    assert len({d.name for d in done}) == len(done), "an object is disturbed once"
    kinds = {d.name: d for d in done}
    for obj in objects:
        # as it would stand without a disturbance of its own
        carrier = by_name[obj.parent] if obj.parent else None
        along = poses[carrier.name] @ inverse(carrier.pose) @ obj.pose if carrier else obj.pose
        change = poses[obj.name] @ inverse(along)
        what = kinds.get(obj.name)
        if what is None:
            assert np.allclose(change, np.eye(4), atol=1e-9)
            continue
        assert not obj.is_let_in
        offset = poses[obj.name][:3, 3] - along[:3, 3]
        turn = abs(yaw_of(change))
        most = HUNG_MOST_M if obj.relation in ("wall", "ceiling") else MOST_M
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
            assert deepest(obj.solid, poses[obj.name], other, there) == pytest.approx(what.amount, abs=1e-4)


@pytest.mark.slow
def test_every_kind_of_disturbance_happens_and_pushes_meet_objects_and_walls() -> None:
    done = [d for index in (2, 5, 7) for d in scene(index).disturbances]
    assert {d.kind for d in done} == {"pushed", "shifted", "turned", "raised", "sunk"}
    targets = [d.target for d in done if d.target]
    assert any(t.startswith("wall") for t in targets)
    assert any(not t.startswith("wall") for t in targets)


@pytest.mark.slow
def test_what_was_raised_from_the_floor_floats_and_what_sank_is_in_it() -> None:
    seen = set()
    for index in (2, 5, 7):
        of = scene(index)
        blobs = {a.asset_id: a.mesh_blob for a in of.rows["assets"]}
        poses = proposed(of)
        assert of.carried is not None
        for d in of.disturbances:
            if d.kind in ("raised", "sunk") and of.carried[d.name].relation == "floor":
                row = next(s for s in of.rows["selections"] if s.instance_id == d.name)
                mesh = trimesh.load_scene(io.BytesIO(of.blobs[blobs[row.asset_id]]), file_type="glb").to_mesh()
                bottom = float(mesh.bounds[0, 1]) * row.scale[2] + poses[d.name][2, 3]  # a GLB is +Y up
                assert bottom == pytest.approx(d.amount if d.kind == "raised" else -d.amount, abs=1e-6)
                seen.add(d.kind)
    assert seen == {"raised", "sunk"}


@pytest.mark.slow
def test_the_same_seed_gives_the_same_rooms_and_another_gives_others() -> None:
    assert generated_scene(1, 20, 0).digest() == scene(1).digest()
    assert generated_scene(1, 20, 1).digest() != scene(1).digest()


@pytest.mark.slow
def test_rooms_have_ten_to_eighty_objects_of_every_kind_of_room_and_some_without_known_pieces() -> None:
    few, many = generated_scene(0, 50, 0), generated_scene(49, 50, 0)
    assert 8 <= len(few.rows["instances"]) <= 20
    assert 70 <= len(many.rows["instances"]) <= 95
    assert {generated_scene(i, 50, 0).rows["shells"][0].room_type for i in range(5)} == set(ROOM_TYPES)
    assert any(asset.pieces_blob is None for i in (2, 5, 7, 8) for asset in scene(i).rows["assets"])
    assert any(row.scale != (1.0, 1.0, 1.0) for i in (2, 5, 7, 8) for row in scene(i).rows["selections"])


@pytest.mark.slow
def test_a_scene_of_39_objects_has_39() -> None:
    assert len(scene_of_count(39, 0).rows["instances"]) == 39


# planted faults


def at_rest(*objects: tuple[str, tuple[float, float, float], np.ndarray, str]) -> BenchScene:
    """A room of objects (category, extents, pose, parent's name) that nothing disturbs."""
    rng = np.random.default_rng(3)
    items = []
    for index, (category, extents, pose, parent) in enumerate(objects):
        model = generate(category, extents, rng)
        items.append(Furnishing(f"{category}_{index}", category, model.parts, model.pieces, pose, extents, parent))
    room = FurnishedRoom("office", SQUARE, 2.6, [], items)
    return disturbed_scene("bench/planted", room, rng, plain_share=0.0, shares=())


def moved(of: BenchScene, name: str, offset: tuple[float, float, float]) -> BenchScene:
    """The same scene with one object elsewhere from the start."""
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
def verdicts(of: tuple[str, tuple[float, float, float]] | None = None, methods: tuple[str, ...] = ("released",)) -> dict[str, Verdict]:
    made = office() if of is None else moved(office(), *of)
    return {v.state: v for v in judge(made, methods, 0, defaultdict(dict)).verdicts}


def test_nothing_is_wrong_with_a_room_at_rest() -> None:
    for state, v in verdicts(None, ("default",)).items():
        assert v.objects == 4
        assert len(v.free) == 4
        for wrong in ("deep", "allowed", "unstable_1cm", "unstable_5cm", "unstable_nudged", "floating", "outside", "lost_reported",
                      "lost_silently", "misjudged", "disagreeing", "fixed_wrongly"):  # fmt: skip
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
    assert of.carried is not None
    # say that the box on the table stood on the cabinet
    told = dataclasses.replace(of, carried={**of.carried, "0002": Carried("on", "0000")})
    result = judge(told, ("released",), 0, defaultdict(dict))
    v = {one.state: one for one in result.verdicts}["released"]
    assert v.lost_silently == v.misjudged == ("0002",)
    assert figures([v])["supports_kept"] == 3
    assert worst_cases([result], "released")[0]["instances"] == ["0002"]
    on_floor = dataclasses.replace(of, carried={**of.carried, "0003": Carried("wall", None)})
    v = {one.state: one for one in judge(on_floor, ("released",), 0, defaultdict(dict)).verdicts}["released"]
    assert v.lost_silently == ("0003",), "it hangs on no wall"


def test_a_counter_along_a_wall_is_rightly_fixed_and_what_was_drawn_standing_is_not() -> None:
    of = at_rest(
        ("kitchen counter", (0.6, 1.6, 0.9), yaw_pose(0.0, [0.3, 1.5, 0.0]), "floor"),
        ("kitchen cabinet", (0.4, 1.0, 0.7), yaw_pose(np.pi, [3.8, 1.5, 1.5]), "wall"),
    )
    assert of.carried is not None
    assert [name for name, carried in of.carried.items() if carried.is_fitted] == ["0000"]
    free = dataclasses.replace(of, carried={name: Carried("floor", None) for name in of.carried})
    for drawn, wrong in ((of, ()), (free, ("0000", "0001"))):
        states = {one.state: one for one in judge(drawn, ("released",), 0, defaultdict(dict)).verdicts}
        assert states["released"].fixed_wrongly == wrong
        assert states["released"].free == ()


def test_a_rug_under_an_object_is_as_good_as_the_floor() -> None:
    of = at_rest(
        ("rug", (2.0, 1.5, 0.01), yaw_pose(0.0, [2.0, 1.5, 0.0]), "floor"),
        ("box", (0.4, 0.4, 0.4), yaw_pose(0.0, [2.0, 1.5, 0.01]), "floor"),
    )
    v = {one.state: one for one in judge(of, ("released",), 0, defaultdict(dict)).verdicts}["input"]
    assert not v.lost_silently
    assert not v.floating


@given(yaw=st.floats(-3, 3), gap=st.floats(-0.02, 0.4), x=st.floats(-0.2, 0.2))
@settings(max_examples=25, deadline=None)
def test_gaps_are_measured_at_any_turn_and_in_any_order(yaw: float, gap: float, x: float) -> None:
    top, obj = trimesh.creation.box((1.0, 1.0, 0.04)), trimesh.creation.box((0.2, 0.3, 0.1))
    solids = [ConvexParts(name, pieces([mesh], [mesh], PieceConfig()).hulls) for name, mesh in (("0000", top), ("0001", obj))]
    poses = {"0000": yaw_pose(0.3, [1, 2, 0.7]), "0001": yaw_pose(yaw, [1 + x, 2, 0.7 + 0.02 + 0.05 + gap])}
    for ordered in (solids, solids[::-1]):
        posed = Measures(ordered, {}, SQUARE, 2.5).at(poses)
        gaps = posed.gaps("0001")
        assert gaps["0000"] == pytest.approx(gap, abs=1e-5)
        assert gaps["floor"] == pytest.approx(0.72 + gap, abs=1e-9)
        assert posed.gaps("0000") == {"floor": pytest.approx(0.68, abs=1e-9)}


@pytest.mark.slow
def test_judging_twice_gives_the_same_but_for_the_times() -> None:
    def timeless(results: SceneVerdicts) -> tuple[Verdict, ...]:
        return tuple(dataclasses.replace(v, seconds=0.0) for v in results.verdicts)

    small = disturbed_scene("bench/small", furnish("office", np.random.default_rng(5), 10), np.random.default_rng(6), plain_share=0.0)
    first, second = (judge(small, ("released", "default"), 1, defaultdict(dict)) for _ in range(2))
    assert timeless(first) == timeless(second)
    assert {v.state for v in first.verdicts} == {"drawn", "input", "released", "default"}
    assert any(far > 0 for _, far in first.verdicts[-1].displaced)


# the command


@pytest.fixture(scope="module")
def report() -> dict[str, Any]:
    done = metascenes(
        {**os.environ, "OMP_NUM_THREADS": "1"}, "bench", "optimization", "--rooms", "1", "--json", "--processes", "2", timeout=1500
    )
    found = dict(json.loads(done.stdout))
    assert done.returncode == any(goal["met"] is False for goal in found["goals"]), done.stderr
    return found


@pytest.mark.slow
@pytest.mark.timeout(1800)  # the whole benchmark of a room, which paper and default are run on
def test_the_command_prints_every_figure(report: dict[str, Any]) -> None:
    assert list(report["states"]) == ["drawn", "input", "released", "default"]
    for state in report["states"].values():
        assert {key for key, _, _ in FIGURES} <= set(state)
        assert state["objects"] == len(generated_scene(0, 1, 0).rows["instances"])
    assert report["states"]["input"]["displacement_mean_m"] == 0
    assert report["states"]["input"]["deep_pairs"] > report["states"]["drawn"]["deep_pairs"]
    assert report["disturbances"] == len(generated_scene(0, 1, 0).disturbances)
    assert set(report["moves"]["seconds_per_move"]) == {"39", "100", "300", "1000"}
    assert report["moves"]["is_same"]
    assert report["moves"]["largest_difference_m3"] <= 1e-9
    assert report["scene"]["count"] == 39
    assert report["scene"]["default"] > 0
    assert report["chains"]["is_same"]
    assert {row["method"] for row in report["pieces"]} == {"hulls", "cut"}
    assert set(report["scene"]["first_seconds"]) == {"released", "default"}
    assert report["states"]["default"]["depths_checked"] > 0
    assert {"processor", "cores", "python", "versions"} <= set(report["machine"])
    assert len(report["goals"]) == 15
    assert all(goal["met"] is not None for goal in report["goals"])


@pytest.mark.timeout(1800)
@pytest.mark.slow
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


@pytest.mark.slow
def test_scenes_of_a_lake_are_read_as_the_stage_reads_them(tmp_path_factory: pytest.TempPathFactory) -> None:
    from bench.optimization import BenchConfig, jobs_of, judge_job
    from warehouse.lake import Lake

    address = str(built(tmp_path_factory)[2])
    reader = Lake.open(address).snapshot()
    jobs = jobs_of(BenchConfig(("released", "default"), lake=address), {})
    assert [job.scene_id for job in jobs] == [row.scene_id for row in reader.rows(Scene)]
    for job in jobs:
        result = judge_job(job)
        assert [v.state for v in result.verdicts] == ["input", "released", "default"]
        rows = {row.instance_id: row for row in reader.rows(Placement, job.scene_id)}
        assert {name for name, _ in result.verdicts[-1].displaced} == set(rows)
        for name, far in result.verdicts[-1].displaced:
            assert far == pytest.approx(rows[name].displacement_m, abs=1e-9), "the run gave what the benchmark measures"


@pytest.mark.slow
def test_moves_alone_are_timed_without_rooms() -> None:
    done = metascenes({**os.environ}, "bench", "optimization", "--moves-only", "--json")
    found = json.loads(done.stdout)
    assert done.returncode == any(goal["met"] is False for goal in found["goals"]), done.stderr
    assert "states" not in found
    assert len(found["goals"]) == 3
    assert found["moves"]["speedup"] > 1
    assert found["moves"]["moves"] == plain.compare(39, 0)["moves"]


def test_an_unknown_method_and_a_missing_lake_are_refused_in_one_line(tmp_path: Any) -> None:
    done = metascenes({**os.environ}, "bench", "optimization", "--methods", "magic")
    assert done.returncode == 2
    assert "'magic' is none of paper, released, default" in done.stderr
    done = metascenes({**os.environ}, "bench", "optimization", "--lake", tmp_path / "none")
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize("given", [("--rooms", "2", "--lake", "x"), ("--moves-only", "--rooms", "2"), ("--lake", "x", "--moves-only")])
def test_options_that_ask_for_two_objects_are_refused(given: tuple[str, ...]) -> None:
    done = CliRunner().invoke(command, ["optimization", *given])
    assert done.exit_code == 2
    assert "leave one out" in done.stderr


@pytest.mark.parametrize(("speedup", "code"), [(5000.0, 0), (2.0, 1)])
def test_a_missed_goal_is_the_exit_code(speedup: float, code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    missed = goals({"moves": moves(speedup=speedup)})
    found = {"goals": missed, "worst": math.nan}
    monkeypatch.setattr("bench.optimization.run_bench", lambda config, advance: found)
    done = CliRunner().invoke(command, ["optimization", "--moves-only", "--json"])
    assert done.exit_code == code
    assert [goal["met"] for goal in json.loads(done.stdout)["goals"]].count(False) == code
    assert "exit code is 1 when a goal is missed" in CliRunner().invoke(command, ["optimization", "--help"]).stdout


# goals


def moves(**other: Any) -> dict[str, Any]:
    """Times of moves that meet every goal."""
    return {
        "is_same": True, "largest_difference_m3": 1e-15, "speedup": 2000.0, "seconds_per_move": {"39": 1e-6, "1000": 2e-6}, **other
    }  # fmt: skip


def met(report: dict[str, Any]) -> dict[str, bool | None]:
    """Whether goals are met, by their words."""
    return {goal["goal"]: goal["met"] for goal in goals(report)}


@pytest.mark.parametrize(
    ("wrong", "goal"),
    [
        ({"is_same": False}, "greatest difference of losses over the same moves [m3]"),
        ({"largest_difference_m3": math.nan}, "greatest difference of losses over the same moves [m3]"),
        ({"largest_difference_m3": 2e-9}, "greatest difference of losses over the same moves [m3]"),
        ({"speedup": 999.0}, "times faster per move than plain Python"),
        ({"seconds_per_move": {"39": 1e-6, "300": 1e-9, "1000": 26e-6}}, "times as long per move at 1000 objects as at 39"),
    ],
)
def test_goals_of_the_moves_are_missed_by_what_is_wrong(wrong: dict[str, Any], goal: str) -> None:
    assert set(met({"moves": moves()}).values()) == {True}
    assert [name for name, is_met in met({"moves": moves(**wrong)}).items() if not is_met] == [goal]


def test_chains_that_differ_and_a_slow_scene_miss_their_goals() -> None:
    for is_same, seconds in ((True, 1.0), (False, 3.0)):
        found = met({"moves": moves(), "chains": {"is_same": is_same}, "scene": {"count": 39, "default": seconds}})
        assert found["rows that are the same for chains on 1 and 2 processes (1: they are)"] is is_same
        assert found["seconds of a scene of 39 objects, warm"] is (seconds < 2)


def test_goals_about_objects_are_neither_met_nor_missed_without_objects_and_missed_by_each_fault() -> None:
    good = verdicts(None, ("default",))["default"]
    whole = met({"moves": moves(), "states": {"default": figures([good])}})
    assert set(whole.values()) == {True}
    nothing = dataclasses.replace(good, objects=0, free=(), carried=0, displaced=(), fixed_wrongly=())
    empty = met({"moves": moves(), "states": {"default": figures([nothing]), "released": figures([nothing])}})
    assert {is_met for goal, is_met in empty.items() if goal not in met({"moves": moves()})} == {None}
    unknown = met({"moves": moves(), "states": {"default": figures([dataclasses.replace(good, fixed_wrongly=None, misjudged=None)])}})
    assert [goal for goal, is_met in unknown.items() if is_met is None] == ["objects fixed wrongly"], "nobody knows of a scan"
    faults: dict[str, Any] = {
        "deep": (("0000", "0001", 0.01),), "unstable_1cm": (("0000", 0.02, 0.0),), "unstable_5cm": (("0000", 0.1, 0.0),),
        "unstable_nudged": (("0000", 0.1, 0.0),),
        "floating": (("0000", 0.1),), "outside_silently": ("0000",), "lost_silently": ("0000",), "fixed_wrongly": ("0000",),
        "disagreeing": (("0000", "0001", 0.01),),
    }  # fmt: skip
    goals_met = [met({"moves": moves(), "states": {"default": figures([dataclasses.replace(good, **{k: v})])}}) for k, v in faults.items()]
    assert [list(found.values()).count(False) for found in goals_met] == [1] * len(faults)
    assert as_text(figures([nothing])["stable_5cm"], "percent") == "n/a"


# what the optimization reports


@cache
def of_the_stage() -> tuple[BenchScene, Outcome]:
    """An office and the default method's rows of it."""
    of = office()
    return of, optimized(of, config_of("default"), context_of(of, 0, defaultdict(dict)))


def saying(line: str, *, remains: bool = False, is_kept: bool = True) -> Outcome:
    """Those rows, in which something is said of 0002."""
    outcome = of_the_stage()[1]
    rows: dict[str, Any] = dict(outcome.rows)
    if remains:
        rows["placements"] = [dataclasses.replace(r, remains=line if r.instance_id == "0002" else None) for r in rows["placements"]]
    rows["supports"] = [dataclasses.replace(r, is_kept=is_kept or r.instance_id != "0002") for r in rows["supports"]]
    return Outcome(degradations=[] if remains else [f"0002: {line}"], **rows)


@pytest.mark.parametrize("remains", [True, False])
@pytest.mark.parametrize(
    ("line", "is_reported"),
    [
        ("it stands beside 0001, on 0000", True),
        ("it stands beside 0001, on the floor", True),
        ("it stands beside 0003, on 0000", False),
        ("nothing carries it; it hangs 0.50 m above the floor", True),
        ("nothing carried it; it was set down 0.30 m onto the floor", True),
        ("nothing carried it; it was set down 0.30 m onto 0001", False),
        ("1.0 cm in 0003", False),
        ("1.0 cm in 0001; 12 % of it lies outside of the room", False),
        ("it stands upside down, as it was proposed", False),
        ("no caption; mass from a density of 300 kg/m3", False),
    ],
)
def test_only_what_says_that_the_carrier_was_lost_reports_that(line: str, is_reported: bool, remains: bool) -> None:
    carried = of_the_stage()[0].carried
    assert carried is not None
    assert carried["0002"].parent_id == "0001"
    assert reported_losses(saying(line, remains=remains), carried) == ({"0002"} if is_reported else set())
    assert reported_losses(saying(line, remains=remains, is_kept=False), carried) == {"0002"}
    assert reported_outside(saying(line, remains=remains)) == ({"0002"} if "outside" in line else set())


def test_an_unreadable_asset_is_counted_as_not_placed() -> None:
    of = office()
    broken = next(row for row in of.rows["selections"] if row.instance_id == "0003").asset_id
    blob = next(row for row in of.rows["assets"] if row.asset_id == broken).mesh_blob
    blobs = Blobs()
    blobs.update({name: b"no GLB" if name == blob else data for name, data in of.blobs.items()})
    result = judge(dataclasses.replace(of, blobs=blobs), ("default",), 0, defaultdict(dict))
    assert [(v.state, v.objects, v.unplaced) for v in result.verdicts] == [("drawn", 3, ()), ("input", 3, ()), ("default", 3, ("0003",))]
    assert figures([result.verdicts[-1]])["unplaced"] == 1


# depths by every axis


@given(seed=st.integers(0, 10**6))
@settings(max_examples=60, deadline=None)
def test_depths_by_every_axis_part_boxes_as_they_must(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes, centers = rng.uniform(0.1, 1.0, (2, 3)), rng.uniform(-0.5, 0.5, (2, 3))
    corners = np.array(list(np.ndindex(2, 2, 2))) - 0.5
    one, other = (Polyhedron.of(corners * size + center) for size, center in zip(sizes, centers, strict=True))
    apart = float((sizes.sum(axis=0) / 2 - np.abs(centers[0] - centers[1])).min())
    pose = yaw_pose(rng.uniform(-3, 3), rng.uniform(-1, 1, 3))
    assert depth_of_pair(one.placed(pose), other.placed(pose)) == pytest.approx(max(apart, 0.0), abs=1e-9)
    clouds = [rng.normal(size=(12, 3)) * 0.3 for _ in range(4)]
    found = depth_of_objects([Polyhedron.of(c) for c in clouds[:2]], [Polyhedron.of(c) for c in clouds[2:]])
    deepest_pair = max(0.0, *(minkowski_depth(a, b) for a in clouds[:2] for b in clouds[2:]))
    assert found == pytest.approx(deepest_pair, abs=1e-9)


def minkowski_depth(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of the origin from the boundary of the hull of all differences [m]; negative outside."""
    differences = (a[:, None] - b[None]).reshape(-1, 3)
    return float(-ConvexHull(differences).equations[:, 3].max())


def test_rows_with_another_depth_are_found_by_every_axis() -> None:
    objects, walls = furnished(1)
    solids = [obj.solid for obj in objects]
    poses = {obj.name: obj.pose for obj in objects}
    of = {solid.name: [hull.vertices for hull in solid.hulls] for solid in (*solids, *walls)}
    found = Colliders(solids, walls).penetrations(np.array([poses[s.name] for s in solids]))
    rows = {(p.a, p.b) if p.b not in poses else (min(p.a, p.b), max(p.a, p.b)): p.depth_m for p in found}
    wrong, checked = disagreeing(rows, solids, walls, poses, of.__getitem__)
    assert not wrong
    assert checked > 0
    first, second = sorted(poses)[:2]
    for pair in ((first, "floor"), (first, second)):
        told = {**rows, pair: rows.get(pair, 0.0) + 0.5}
        assert disagreeing(told, solids, walls, poses, of.__getitem__)[0] == [(*pair, pytest.approx(0.5, abs=1e-9))]
