"""Scenes that a model draws, in the lake: what is made, what a second command does, what a kill leaves, and what is refused."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import shutil
import signal
import types
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner

from flows.commands.lake import erase
from flows.commands.synthesize import command
from flows.inputs.synthesis import DrawingModel, SceneRequest, Synthesized, asked, asking, batches, jobs, synthesize, workers
from flows.outputs.explain import explain
from flows.worker import RowsGone
from schemas.candidates import Asset
from schemas.captions import Caption
from schemas.capture import Instance, Scene
from schemas.errors import InputError
from schemas.exports import ExportCheck, ExportFile
from schemas.families.export_formats import EXPORT_FORMATS
from schemas.optimization import Certificate, Placement
from schemas.runs import StageRun
from schemas.synthesis import Synthesis, SynthesisObject
from tasks.furniture import tops
from tasks.micro_scenes.categories import read_categories
from tasks.pipeline import upstream
from tasks.synthesis.layout import Large, Layout
from tasks.synthesis.scenes.drawn import Drawn
from tests.furnished import furnished_lake
from tests.samples import sample
from warehouse.lake import Lake
from warehouse.questions.views import views
from warehouse.release.licenses import Allowed
from warehouse.tables.digest import digests
from warehouse.upkeep.erasure import dependents
from warehouse.upkeep.erasure import erase as erase_rows
from warehouse.upkeep.erasure.dependents import FurnishedAnewError

CATEGORIES = read_categories()
WANTED = SceneRequest(large="nightstand", room_type="bedroom")


@dataclasses.dataclass(frozen=True)
class Deadly(Drawn):
    """A layout that takes along whoever makes a scene of it."""

    def rng(self, *words: object) -> np.random.Generator:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError


class Rules:
    """Draws as the generator of tops does; of others than nightstands and tables it knows nothing."""

    def check(self, large: Large) -> None:
        if large.category not in ("nightstand", "table"):
            raise InputError("synthesis", "large", f"{large.category} is not known", "ask for a nightstand")

    def draw(self, larges: Sequence[Large], seed: int, numbers: Sequence[int]) -> list[Layout]:
        made = []
        for large, number in zip(larges, numbers, strict=True):
            top = tops.draw("nightstand", large.size, "bedroom", np.random.default_rng([seed, number]))
            made.append(Layout(large, tuple(map(CATEGORIES.merged, top.words)), top.centers, top.sizes, top.yaws))
        return made


MODEL = DrawingModel("5" * 64, "physcene", "CC0-1.0", "rules", Rules())


def ask(lake: Lake, request: SceneRequest = WANTED, count: int = 2, **options: object) -> Synthesized:
    return synthesize(lake, asked(lake, request), MODEL, count=count, **options)  # type: ignore[arg-type]


def actions(done: Synthesized) -> list[str]:
    return [scene.action for scene in done.scenes]


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """Two drawn scenes. Read only."""
    lake = Lake.open(tmp_path_factory.mktemp("drawn") / "lake")
    done = ask(lake)
    assert actions(done) == ["draw", "draw"]
    assert [scene.error for scene in done.scenes] == [None, None]
    return lake


@pytest.mark.whole
def test_a_drawn_scene_ends_in_simulators(straight: Lake, tmp_path: Path) -> None:
    reader = straight.snapshot()
    scenes, syntheses = reader.rows(Scene), reader.rows(Synthesis)
    assert [row.scan_format for row in scenes] == ["synthesis"] * 2
    assert {row.license for row in scenes} == {row.license for row in reader.rows(Asset)} == {"CC0-1.0"}
    assert {row.origin for row in reader.rows(Placement)} == {"synthesis"}
    checks = reader.rows(ExportCheck)
    assert {row.format for row in checks} == set(EXPORT_FORMATS)
    assert [row for row in checks if not row.passed] == []
    stable = [row.is_stable_1cm for row in reader.rows(Certificate) if row.engine == "mujoco"]
    assert len(stable) == len(reader.rows(Placement)) == 2 + sum(row.object_count for row in syntheses)
    assert all(stable)
    for file in reader.rows(ExportFile, scenes[0].scene_id):
        if file.format == "mjcf":
            place = tmp_path / file.path
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(straight.blobs[file.file_blob])
    (document,) = tmp_path.rglob("scene.xml")
    model = mujoco.MjModel.from_xml_path(str(document))
    assert model.njnt >= syntheses[0].object_count


@pytest.mark.whole
def test_rows_say_what_they_are_of(straight: Lake) -> None:
    reader = straight.snapshot()
    for run in reader.rows(StageRun):
        reasons = dict(part.split("=", 1) for part in run.reasons)
        assert (reasons["model"], reasons["seed"], reasons["number"]) == (MODEL.model_id, "0", run.scene_id[-1])
    for row in reader.rows(Synthesis):
        objects = reader.rows(SynthesisObject, row.scene_id)
        known = {one.instance_id: one.category for one in reader.rows(Instance, row.scene_id)}
        assert len(objects) == row.object_count
        assert [one.category for one in objects] == [CATEGORIES.merged(known[one.instance_id]) for one in objects]
        lineage = explain(straight, f"{row.scene_id}/{objects[0].instance_id}")
        assert lineage.problems == ()
        assert any(node.kind == "model" and node.key == MODEL.model_id for node in lineage.nodes.values())
        assert explain(straight, row.scene_id).problems == ()
    connection = reader.connect()
    for view in views():
        connection.sql(f'FROM "{view.name}"').fetchall()


@pytest.mark.whole
def test_every_stage_names_what_it_read(straight: Lake) -> None:
    from tasks.pipeline import STAGES

    runs = {(run.scene_id, run.stage): run for run in straight.snapshot().rows(StageRun)}
    for (scene, stage), run in runs.items():
        read = {part.partition("=")[0] for part in run.upstream}
        declared = next(one for one in STAGES if one.name == stage)
        assert read == {other.name for other in upstream(declared) if (scene, other.name) in runs}
        assert all(part == f"{name}={runs[scene, name].fingerprint}" for part in run.upstream for name in [part.partition("=")[0]])


@pytest.mark.whole
def test_the_same_request_again_does_nothing_and_a_killed_one_is_finished(
    straight: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = digests(straight.snapshot()), straight.snapshot().snapshot_id
    assert actions(ask(straight, workers=2)) == ["reuse", "reuse"]
    assert (digests(straight.snapshot()), straight.snapshot().snapshot_id) == before

    lake, run = Lake.open(tmp_path / "lake"), jobs._Scene.run

    def stopped(self: jobs._Scene, job: jobs.Job) -> str | None:
        if (job.scene_id[-1], job.stage) == ("1", "navigation"):
            raise KeyboardInterrupt
        return run(self, job)

    with monkeypatch.context() as patched:
        patched.setattr(jobs._Scene, "run", stopped)
        with pytest.raises(KeyboardInterrupt):
            ask(lake)
    assert lake.snapshot().rows(Scene) == []
    again = ask(lake, dry_run=True)
    assert actions(again) == ["reuse", "go on"]
    assert lake.snapshot().rows(Scene) == [], "a dry run writes nothing"
    with pytest.raises(InputError, match="another request drew"):  # nothing of it is committed yet
        ask(lake, SceneRequest(large="nightstand"), name=again.scenes[0].scene_id[len("synthetic/") : -len("_0000")])
    assert actions(ask(lake)) == ["reuse", "go on"]
    assert digests(lake.snapshot()) == before[0]


@pytest.mark.whole
def test_more_scenes_leave_the_first_as_they_are_with_any_number_of_workers(straight: Lake, tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    assert actions(ask(lake, count=1)) == ["draw"]
    assert actions(ask(lake, workers=2)) == ["reuse", "draw"]
    assert digests(lake.snapshot()) == digests(straight.snapshot())


@pytest.mark.slow
@pytest.mark.whole
def test_a_failure_stops_no_other_scene_and_is_told_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake, stage = Lake.open(tmp_path / "lake"), jobs._stage("navigation")

    def broken(**inputs: object) -> object:
        if getattr(inputs["context"], "scene_id", "").endswith("_0000"):
            raise InputError("floor", "area", "is too slippery", "sweep it")
        return stage.run(**inputs)

    with monkeypatch.context() as patched:
        patched.setattr(jobs, "_stage", lambda name: dataclasses.replace(stage, run=broken) if name == stage.name else find(name))
        find = {one: jobs.STAGES[i] for i, one in enumerate(s.name for s in jobs.STAGES)}.__getitem__
        done = ask(lake)
    assert [scene.error for scene in done.scenes] == ["navigation: floor: area: is too slippery; sweep it", None]
    again = ask(lake)
    assert actions(again) == ["report", "reuse"]
    assert again.failed[0].error == done.failed[0].error
    assert actions(ask(lake, retry_failed=True)) == ["go on", "reuse"]
    assert actions(ask(lake)) == ["reuse", "reuse"]


@pytest.mark.whole
def test_what_passes_is_no_failure_of_the_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake, stage, find = Lake.open(tmp_path / "lake"), jobs._stage("navigation"), jobs._stage
    for error in (OSError(errno.ENOSPC, "No space left on device"), RowsGone("rows: replaced; run again"), ConnectionError("away")):

        def refused(error: Exception = error, **_: object) -> object:
            raise error

        with monkeypatch.context() as patched:
            patched.setattr(jobs, "_stage", lambda name: dataclasses.replace(stage, run=refused) if name == "navigation" else find(name))
            assert len(ask(lake, count=1).failed) == 1
        last = max((run for run in lake.snapshot().rows(StageRun) if run.stage == "navigation"), key=lambda run: run.started_at)
        assert (last.outcome, last.error_kind) == ("lost", "lost")
        assert actions(ask(lake, count=1, dry_run=True)) == ["go on"]

    def full(*_: object) -> object:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:  # not even for the row that says so
        patched.setattr(Lake, "stage_rows", full)
        (scene,) = ask(lake, count=1).scenes
        assert "No space left on device" in str(scene.error)
    assert actions(ask(lake, count=1)) == ["go on"]
    assert actions(ask(lake, count=1)) == ["reuse"]


@pytest.mark.slow
@pytest.mark.whole
def test_a_worker_that_dies_takes_one_scene_along(straight: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake, layouts = Lake.open(tmp_path / "lake"), batches._with_layouts

    def deadly(*arguments: object) -> object:
        made, problems = layouts(*arguments)  # type: ignore[arg-type]
        first = made[0]
        assert first.drawn is not None
        return made | {0: dataclasses.replace(first, drawn=Deadly(**vars(first.drawn)))}, problems

    with monkeypatch.context() as patched:
        patched.setattr(batches, "_with_layouts", deadly)
        done = ask(lake, workers=1)
    assert [scene.error is None for scene in done.scenes] == [False, True]
    assert str(done.scenes[0].error).startswith("capture: the worker died")
    assert {run.outcome for run in lake.snapshot().rows(StageRun) if run.scene_id == done.scenes[0].scene_id} == {"lost"}
    assert actions(ask(lake)) == ["draw", "reuse"]
    assert digests(lake.snapshot()).keys() == digests(straight.snapshot()).keys()
    assert {table: value for table, value in digests(lake.snapshot()).items() if table != "stage_runs"} == {
        table: value for table, value in digests(straight.snapshot()).items() if table != "stage_runs"
    }


@pytest.mark.whole
def test_two_commands_at_once_share_the_work(straight: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake = Lake.open(tmp_path / "lake")
    first = ask(lake, dry_run=True).scenes[0].scene_id
    with lake.claims() as claims, monkeypatch.context() as patched:
        assert claims.claim(first)
        waited: list[float] = []

        def other(seconds: float) -> None:
            waited.append(seconds)
            if len(waited) == 1:
                return
            claims.release(first)
            assert actions(ask(lake, count=1)) == ["draw"]

        patched.setattr(batches.time, "sleep", other)
        done = ask(lake)
    assert actions(done) == ["reuse", "draw"]
    assert len(waited) == 2
    assert {run.attempt for run in lake.snapshot().rows(StageRun)} == {1}
    assert digests(lake.snapshot()) == digests(straight.snapshot())
    assert lake.claimed() == {}


def test_layouts_are_drawn_side_by_side_and_one_that_is_none_has_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake, drawn = Lake.open(tmp_path / "lake"), []

    class Told(Rules):
        def draw(self, larges: Sequence[Large], seed: int, numbers: Sequence[int]) -> list[Layout]:
            drawn.append(list(numbers))
            layouts = super().draw(larges, seed, numbers)
            return [dataclasses.replace(one, yaws=one.yaws + (np.nan if n == 3 else 0)) for one, n in zip(layouts, numbers, strict=True)]

    monkeypatch.setattr(workers, "make_scene", lambda job: jobs.SceneDone(job.scene_id))
    model = dataclasses.replace(MODEL, drawer=Told())
    done = synthesize(lake, asked(lake, WANTED), model, count=20)
    assert drawn == [list(range(16)), list(range(16, 20))]
    assert [scene.number for scene in done.failed] == [3]
    drawn.clear()
    again = synthesize(lake, asked(lake, WANTED), model, count=4)
    assert (again.scenes[3].action, again.scenes[3].error) == ("report", done.scenes[3].error)
    assert drawn == [[0, 1, 2]], "what failed on the same input is not drawn again"


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """A furnished room whose table was furnished anew."""
    lake = furnished_lake(tmp_path_factory.mktemp("rooms") / "lake", scenes=1)
    done = ask(lake, SceneRequest(instance="demo/room_0/0001"), count=1, name="anew")
    assert [scene.error for scene in done.scenes] == [None]
    return lake


@pytest.fixture
def erasable(rooms: Lake, tmp_path: Path) -> Lake:
    shutil.copytree(rooms.address, tmp_path / "lake")
    return Lake.open(tmp_path / "lake")


@pytest.mark.whole
def test_a_large_object_of_a_scene_is_furnished_anew(rooms: Lake) -> None:
    reader, scene, base = rooms.snapshot(), "synthetic/anew_0000", "demo/room_0"
    (row,) = reader.rows(Synthesis)
    assert (row.based_on, row.based_on_instance, row.instance_id) == (base, "0001", "0001")
    before, after = ({one.instance_id: one for one in reader.rows(Instance, name)} for name in (base, scene))
    drawn = {one.instance_id for one in reader.rows(SynthesisObject, scene)}
    assert len(drawn) == row.object_count > 0
    assert set(after) & set(before) == set(before) - {"0002", "0003", "0005"}, "what stood on the table, or by it, went"
    assert set(after) - set(before) == drawn
    old, new = ({one.instance_id: one for one in reader.rows(Placement, name)} for name in (base, scene))
    assert {one for one in new if new[one].origin == "synthesis"} == drawn
    for name in set(old) & set(new):
        assert (new[name].asset_id, new[name].origin, new[name].annotator) == (old[name].asset_id, old[name].origin, old[name].annotator)
        np.testing.assert_allclose(new[name].proposed_pose, old[name].optimized_pose)
    assert {one.room_id for one in reader.rows(Scene)} == {base}, "rooms are not split in two"
    lineage = explain(rooms, f"{scene}/{min(drawn)}")
    assert lineage.problems == ()
    assert f"instance:{base}/0001" in lineage.nodes


@pytest.mark.whole
def test_other_names_and_large_objects_are_refused(rooms: Lake) -> None:
    with pytest.raises(InputError, match="which nobody drew"):
        ask(rooms, dataset="demo")
    with pytest.raises(InputError, match="another request drew"):
        ask(rooms, name="anew")
    with pytest.raises(InputError, match="is no large object, but a lamp"):
        asked(rooms, SceneRequest(instance="demo/room_0/0002"))
    with pytest.raises(InputError, match="another request drew"):  # other assets are another request
        ask(rooms, SceneRequest(instance="demo/room_0/0001"), name="anew", use_assets=False)
    with pytest.raises(InputError, match="is no instance of its scene"):
        asked(rooms, SceneRequest(instance="demo/room_0/0099"))
    with pytest.raises(InputError, match="ask for a nightstand"):
        ask(rooms, SceneRequest(large="desk"))
    for wrong in ({"dataset": "Other"}, {"dataset": "a/b"}, {"name": "a b"}, {"name": "../x"}, {"count": 0}):
        with pytest.raises(InputError):
            ask(rooms, **wrong)  # type: ignore[arg-type]


@pytest.mark.whole
def test_what_a_base_is_asked_for_must_be_there_and_of_a_size(rooms: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    request = SceneRequest(instance="demo/room_0/0001")
    wanted = asked(rooms, request)

    class Narrow(Rules):
        def check(self, large: Large) -> None:
            if large.room_type not in ("bedroom", "unknown"):
                raise InputError("synthesis", "room", f"{large.room_type} is not known", "ask for a bedroom")

    model = dataclasses.replace(MODEL, drawer=Narrow())
    hall = dataclasses.replace(wanted, room_type="hall")
    assert actions(synthesize(rooms, hall, model, count=1, dry_run=True)) == ["draw"], "nobody can choose the kind of a room that is there"
    with pytest.raises(InputError, match="ask for a bedroom"):
        synthesize(rooms, dataclasses.replace(hall, base=None), model, count=1, dry_run=True)
    with monkeypatch.context() as patched:
        patched.setattr(asking, "MOST_M", 0.3)
        with pytest.raises(InputError, match="no size of furniture"):
            asked(rooms, request)
    with pytest.raises(InputError, match="was changed meanwhile"):
        synthesize(rooms, dataclasses.replace(wanted, content=("capture=other",)), MODEL, count=1)
    assert rooms.claimed() == {}


@pytest.mark.whole
def test_a_scene_follows_from_the_rows_of_its_base_that_were_read(rooms: Lake) -> None:
    request, reader = SceneRequest(instance="demo/room_0/0001"), rooms.snapshot()
    before = asked(rooms, request).content
    assert [part.partition("=")[0] for part in before] == sorted(
        {"capture", "captions", "candidates", "selection", "optimization", "micro_scenes"}
        & {run.stage for run in reader.rows(StageRun, "demo/room_0")}
    )
    run = next(run for run in reader.rows(StageRun, "demo/room_0") if run.stage == "captions")
    newer = dataclasses.replace(run, fingerprint="f" * 64, started_at=datetime.now(UTC), attempt=1)
    rooms.stage_rows(newer, {"captions": reader.rows(Caption, "demo/room_0")})
    try:
        assert asked(rooms, request).content == before, "rows that are staged were not read"
    finally:
        rooms.unstage(newer)


def test_other_requests_have_other_names(rooms: Lake) -> None:
    wanted = asked(rooms, SceneRequest(instance="demo/room_0/0001"))
    assert wanted.base is not None

    def name(scene_id: str, **options: object) -> str:
        scene = dataclasses.replace(wanted.base.scene, scene_id=scene_id, scan=scene_id.partition("/")[2])  # type: ignore[union-attr]
        of = dataclasses.replace(wanted, base=dataclasses.replace(wanted.base, scene=scene))
        return synthesize(rooms, of, MODEL, count=1, dry_run=True, **options).scenes[0].scene_id  # type: ignore[arg-type]

    scans = ["a.b/c", "a/b.c", "a/b_c", "a_b/c", f"a/{'x' * 60}", f"b/{'x' * 60}", f"a/{'x' * 59}y"]
    named = [name(scan) for scan in scans]
    named += [name("a/c", use_assets=False), name("a/c"), name("a/c", licenses=Allowed(("CC0-1.0",))), name("a/c", seed=1)]
    assert len(set(named)) == len(named)
    assert all(one.count("_0001_physcene_") == 1 and len(one) < 80 for one in named), "the object and who drew it are named"
    both = name("a/c", licenses=Allowed(("MIT", "CC0-1.0")))
    assert both == name("a/c", licenses=Allowed(("CC0-1.0", "MIT")))


@pytest.mark.slow
@pytest.mark.whole
def test_who_erases_a_scene_erases_what_was_made_of_it(erasable: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Lake, "commit", killed)
        with pytest.raises(KeyboardInterrupt):
            ask(erasable, SceneRequest(instance="demo/room_0/0001"), count=1)
    (staged,) = {run.run.scene_id for run in erasable.staging.runs()}
    runner = CliRunner()
    told = runner.invoke(erase, ["demo/room_0", "--dry-run", "--json", "--lake", erasable.address])
    assert set(json.loads(told.output)["also"]) == {"synthetic/anew_0000", staged}
    assert len(erasable.snapshot().rows(Scene)) == 2
    done = runner.invoke(erase, ["demo/room_0", "--yes", "--lake", erasable.address], catch_exceptions=False)
    assert "0 hits" in done.output
    assert erasable.snapshot().rows(Scene) == []
    assert erasable.staging.runs() == []


@pytest.mark.whole
def test_what_is_erased_while_it_is_furnished_anew_comes_back_in_no_snapshot(erasable: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    commit, runner, staged = Lake.commit, CliRunner(), []

    def late(self: Lake, *words: object, **options: object) -> object:
        monkeypatch.undo()
        staged.extend(self.staging.runs())
        with pytest.raises(FurnishedAnewError, match=r"as synthetic/.*erase these first"):
            erase_rows(self, "demo/room_0")
        for run in staged:  # not staged yet when the erasure looks
            self.unstage(run.run)
        told = json.loads(runner.invoke(erase, ["demo/room_0", "--yes", "--json", "--lake", self.address], catch_exceptions=False).output)
        assert {hit["path"].partition("/")[0] for hit in told["proof"]["hits"]} <= {"claims", "blobs"}, (
            "what this command holds and has put"
        )
        for run in staged:
            self.stage_rows(run.run, {})
        return commit(self, *words, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(Lake, "commit", late)
    with pytest.raises(InputError, match="was erased meanwhile"):
        ask(erasable, SceneRequest(instance="demo/room_0/0001"), count=1)
    assert {run.run.scene_id.partition("/")[0] for run in staged} == {"synthetic"}
    assert erasable.staging.runs() == []
    assert erasable.snapshot().rows(Scene) == []


@pytest.mark.slow
@pytest.mark.whole
def test_what_is_furnished_anew_while_its_scene_is_erased_goes_too(erasable: Lake, monkeypatch: pytest.MonkeyPatch) -> None:
    look = dependents.furnished_anew

    def before(lake: Lake, scene_id: str) -> tuple[str, ...]:
        monkeypatch.undo()
        found = look(lake, scene_id)
        ask(lake, SceneRequest(instance="demo/room_0/0001"), count=2)
        return found

    monkeypatch.setattr(dependents, "furnished_anew", before)
    told = CliRunner().invoke(erase, ["demo/room_0", "--yes", "--json", "--lake", erasable.address], catch_exceptions=False)
    assert len(json.loads(told.output)["also"]) == 3
    assert erasable.snapshot().rows(Scene) == []
    assert erasable.staging.runs() == []


@pytest.mark.parametrize(
    ("of_model", "of_base", "license_"),
    [
        ("CC0-1.0", "CC0-1.0", "CC0-1.0"), ("CC-BY-4.0", "CC0-1.0", "CC-BY-4.0"), ("MIT-0", "CC-BY-4.0", "CC-BY-4.0"),
        ("CC-BY-NC-4.0", "CC-BY-4.0", "CC-BY-4.0 AND CC-BY-NC-4.0"), ("CC0-1.0", None, None),
        ("MIT OR GPL-3.0-only", "CC-BY-4.0", "CC-BY-4.0 AND (MIT OR GPL-3.0-only)"),
    ],
)  # fmt: skip
def test_a_scene_has_the_licenses_of_model_and_base(of_model: str, of_base: str | None, license_: str | None) -> None:
    model = dataclasses.replace(MODEL, license=of_model)
    base = types.SimpleNamespace(scene=sample(Scene, license=of_base))
    assert batches._license(model, types.SimpleNamespace(base=base)) == license_  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--large", "dsk"], "did you mean desk?"),
        (["--large", "mug"], "is no large object"),
        (["--large", "desk", "--room-type", "ofice"], "did you mean office?"),
        (["--large", "desk", "--size", "0.1", "1", "1"], "is no size of furniture"),
        (["--large", "desk", "--model", "fyscene"], "did you mean physcene?"),
        (["--instance", "demo/none/0001"], "is in no scene of the lake"),
    ],
)
def test_what_there_is_not_is_refused_with_what_there_is(arguments: list[str], said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        CliRunner().invoke(command, [*arguments, "--lake", str(tmp_path / "lake")], catch_exceptions=False)
    assert said in str(refused.value)
    assert not (tmp_path / "lake").exists()


@pytest.mark.parametrize("arguments", [[], ["--large", "desk", "--instance", "a/b/0001"], ["--large", "desk", "--seed", "-1"]])
def test_misuse_ends_with_two(arguments: list[str], tmp_path: Path) -> None:
    assert CliRunner().invoke(command, [*arguments, "--lake", str(tmp_path / "lake")]).exit_code == 2
