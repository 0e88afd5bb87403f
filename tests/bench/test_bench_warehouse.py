"""The benchmark of the warehouse: what it generates is a lake like any other, and its figures are what it measured."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pyarrow as pa
import pytest
from click.testing import CliRunner

from bench.warehouse import generator, growth, refusals, report, volumes
from bench.warehouse.answers import peak_memory_mb, time_answers
from bench.warehouse.generator import copied_lake, generated_lake
from flows.commands.bench import command
from schemas.errors import InputError
from schemas.families.export_formats import EXPORT_FORMATS
from schemas.record import arrow_to_rows, check
from schemas.tables import TABLES
from tasks.pipeline import SCENE_STAGES
from warehouse.lake import Lake
from warehouse.questions.sql import query
from warehouse.questions.views import views
from warehouse.tables.delta import nullable
from warehouse.upkeep.inspection import inspect

pytestmark = pytest.mark.whole

SCENES = 40


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("METASCENES_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="module")
def lake(cache: Path) -> Lake:
    return generated_lake(SCENES)


def asked(lake: Lake, sql: str) -> list[tuple]:
    return [tuple(row.values()) for row in query(lake.snapshot(), sql).to_pylist()]


@pytest.mark.slow
@pytest.mark.parametrize("table", TABLES.values(), ids=lambda table: table.name)
def test_every_generated_row_is_valid(lake: Lake, table) -> None:
    rows = lake.snapshot().rows(table.record)
    assert rows, "the table is empty"
    check(rows, table.record)


def test_tables_that_no_file_describes_have_rows_of_their_schema() -> None:
    """What a further stage writes is in generated lakes from its first day."""
    made = [table for name, table in TABLES.items() if name not in generator._ABOUT_THE_LAKE]
    with generator._connection(SCENES, 0, [0]) as connection:
        connection.execute("SET VARIABLE part = 1")
        for table in made:
            found = connection.sql(generator._typed(connection, table, generator._made_up(table))).to_arrow_table()
            rows = arrow_to_rows(found.cast(nullable(table.arrow_schema)), table.record)
            check(rows, table.record)
            objects = 40 * SCENES if "instance_id" in table.key else SCENES
            assert len(rows) == (objects if "scene_id" in table.key else 1), table.name
    described = {path.stem for path in (Path(generator.__file__).parent / "rows").glob("*.sql")}
    assert described <= {table.name for table in made}
    assert len({run["stage"] for run in generator._runs()}) == len(SCENE_STAGES)


@pytest.mark.slow
def test_a_generated_lake_has_no_fault_but_the_blobs_that_it_does_not_have(lake: Lake) -> None:
    found = inspect(lake, quick=True)
    others = [str(one) for one in found.findings if not one.file.startswith(("blobs", "releases"))]
    assert others == []
    assert found.snapshots == 3
    assert len(found.findings) > 0, "blobs are missing: the inspection looked"


def test_the_proportions_are_those_that_are_said(lake: Lake) -> None:
    [(scenes, objects, candidates, frames, files, episodes, steps)] = asked(
        lake,
        "SELECT (SELECT count(*) FROM scenes), (SELECT count(*) FROM instances WHERE NOT is_structure), (SELECT count(*) FROM candidates),"
        "(SELECT count(*) FROM frames), (SELECT count(*) FROM export_files), (SELECT count(*) FROM episodes),"
        "(SELECT count(*) FROM optimization_steps)",
    )
    assert (scenes, objects, candidates) == (SCENES, 40 * SCENES, 400 * SCENES)
    assert (frames, files, episodes, steps) == (100 * SCENES, 8 * len(EXPORT_FORMATS) * SCENES, 10 * SCENES, 100 * SCENES)


def test_rows_agree_with_each_other(lake: Lake) -> None:
    unmatched = {
        "chosen candidates": "FROM selections ANTI JOIN candidates USING (scene_id, instance_id, slot, asset_id)",
        "filled slots": "FROM (FROM candidates WHERE outcome = 'filled') "
        "ANTI JOIN selections USING (scene_id, instance_id, slot, asset_id)",
        "named assets": "FROM (FROM candidates WHERE asset_id IS NOT NULL) ANTI JOIN assets USING (asset_id)",
        "nameless assets": "FROM assets ANTI JOIN candidates USING (asset_id)",
        "retrieved": "FROM (SELECT library, library_file AS file, asset_id FROM candidates WHERE library IS NOT NULL) "
        "ANTI JOIN library_models USING (library, file, asset_id)",
        "refusals counted": "FROM libraries WHERE refused_count <> (SELECT count(*) FROM refused_models)",
        "placed": "FROM placements ANTI JOIN selections USING (scene_id, instance_id, asset_id)",
        "seen": "FROM masks ANTI JOIN frames USING (scene_id, frame_id)",
        "best frames": "FROM (SELECT scene_id, instance_id, unnest(best_frames) AS frame_id FROM instances) "
        "ANTI JOIN masks USING (scene_id, frame_id, instance_id)",
        "carried": "FROM (SELECT scene_id, parent_id AS instance_id FROM supports WHERE parent_id IS NOT NULL) "
        "ANTI JOIN placements USING (scene_id, instance_id)",
        "walked": "FROM trajectories ANTI JOIN episodes USING (scene_id, episode_id, instance_id, start_position)",
        "driven": "FROM robot_runs ANTI JOIN (SELECT *, batch_id AS trajectory_batch_id FROM trajectories) "
        "USING (scene_id, episode_id, trajectory_batch_id, instance_id)",
        "tested": "FROM compared_runs ANTI JOIN trajectories USING (scene_id, batch_id)",
        "learned": "FROM compared_runs ANTI JOIN models USING (model_id, training_id)",
        "answered": "FROM annotations ANTI JOIN instances USING (scene_id, instance_id)",
        "verdicts": "FROM (SELECT scene_id, format, bool_and(passed) AS passed FROM export_checks GROUP BY ALL) "
        "ANTI JOIN export_files USING (scene_id, format, passed)",
    }
    assert {name: asked(lake, f"SELECT count(*) {sql}")[0][0] for name, sql in unmatched.items()} == dict.fromkeys(unmatched, 0)
    [(wrong,)] = asked(lake, "SELECT count(*) FROM instances WHERE abs(box_volume_m3 / list_product(box_size) - 1) > 1e-9")
    assert wrong == 0


@pytest.mark.slow
def test_what_stage_runs_say_was_written_is_there(lake: Lake) -> None:
    said = asked(lake, "SELECT scene_id, unnest(row_counts) FROM current_runs WHERE contains(scene_id, '/')")
    said = [(scene, entry) for scene, entry in said if not entry.startswith("splits=")]  # by room
    reader = lake.snapshot()
    counted = {
        name: dict(asked(lake, f"SELECT scene_id, count(*) FROM {name} GROUP BY scene_id"))
        for name in {entry.split("=")[0] for _, entry in said}
    }  # fmt: skip
    assert reader.snapshot_id == 3
    assert said
    for scene, entry in said:
        name, _, count = entry.partition("=")
        assert counted[name].get(scene, 0) == int(count)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_rows_and_another_one_others(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path))
    again, other = generated_lake(SCENES), generated_lake(SCENES, seed=1)
    assert again.address != lake.address
    for name in TABLES:
        assert lake.snapshot().arrow(name).equals(again.snapshot().arrow(name)), name
    assert not lake.snapshot().arrow("instances").equals(other.snapshot().arrow("instances"))


def test_a_lake_is_made_once(lake: Lake) -> None:
    told: list[str] = []
    assert generated_lake(SCENES, progress=told.append).address == lake.address
    assert told == []


def test_earlier_snapshots_hold_fewer_scenes(lake: Lake) -> None:
    held = [set(lake.snapshot(number).arrow("scenes")["scene_id"].to_pylist()) for number in (1, 2, 3)]
    assert held[0] < held[1] < held[2]
    assert [row.scenes for row in lake.snapshot().releases] == [len(scenes) for scenes in held]


def test_a_copy_can_be_changed_without_the_original(lake: Lake, tmp_path: Path) -> None:
    copy = copied_lake(lake, tmp_path / "copy")
    before = refusals.digest_of(Path(lake.address))
    scene = copy.snapshot().arrow("scenes")["scene_id"][0].as_py()
    assert copy.remove_scene(scene) is not None
    assert copy.snapshot().arrow("instances", scene).num_rows == 0
    assert refusals.digest_of(Path(lake.address)) == before


def test_a_lake_that_has_no_room_is_not_begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path))
    with pytest.raises(InputError, match="METASCENES_CACHE"):
        generated_lake(10**12)
    assert list((tmp_path / "bench").iterdir()) == []


def test_what_fails_half_way_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path))

    def stop(table: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generated_lake(10, progress=stop)
    assert list((tmp_path / "bench").iterdir()) == []


@pytest.mark.slow
def test_every_question_is_timed_and_answered(lake: Lake) -> None:
    asked_for = report.questions(lake)
    found = time_answers(lake.address, asked_for, runs=2)
    assert [answer.name for answer in found["answers"]] == list(asked_for)
    with lake.snapshot().connect() as connection:
        for answer in found["answers"]:
            assert answer.rows == connection.sql(asked_for[answer.name]).to_arrow_table().num_rows
            assert answer.first_seconds > 0
            assert answer.seconds > 0
            assert answer.runs >= 2
    assert 50 < found["peak_memory_mb"] <= peak_memory_mb() * 1.001


def test_what_is_asked_only_of_large_answers_is_not_asked_of_small_ones(lake: Lake) -> None:
    asked_for = {"scenes": "SELECT * FROM scenes", "many": "SELECT 1", "few": "SELECT 2"}
    found = time_answers(lake.address, asked_for, 2, {"many": ("scenes", SCENES - 1), "few": ("scenes", SCENES)})
    assert [answer.name for answer in found["answers"]] == ["scenes", "many"]


def test_every_view_answers(lake: Lake) -> None:
    with lake.snapshot().connect() as connection:
        empty = [view.name for view in views() if not connection.sql(f'FROM "{view.name}" LIMIT 1').to_arrow_table().num_rows]
    assert set(empty) <= {"failures", "broken_rules", "quality_history", "scan_duplicates"}, "what the rows do not show"


def test_the_box_plot_is_the_same_with_pandas_and_on_one_file(lake: Lake) -> None:
    found = volumes.time_volumes(lake.address, runs=2)
    assert found["differences"] == {"sorted": 0, "by_key": 0, "pandas": 0}
    assert set(volumes.ratios(found)) == {"pandas", "sorted", "by_key"}
    assert volumes.ratios(found)["pandas"] == pytest.approx(found["pandas_seconds"] / found["lake"].seconds)


def test_a_wrong_box_is_noticed(lake: Lake) -> None:
    boxes = query(lake.snapshot(), volumes.QUERY)
    assert boxes.num_rows == volumes.CATEGORIES
    wrong = boxes["q3_m3"].to_pylist()
    wrong[7] *= 1 + 1e-9
    changed = boxes.set_column(boxes.schema.get_field_index("q3_m3"), "q3_m3", pa.array(wrong))
    assert volumes.differences(boxes, boxes) == 0
    assert volumes.differences(boxes, changed) == 1
    assert volumes.differences(boxes, boxes.slice(1)) == len(volumes.FIGURES) * boxes.num_rows


@pytest.mark.slow
def test_everything_that_must_be_refused_is(cache: Path, tmp_path: Path) -> None:
    small = copied_lake(generated_lake(10), tmp_path / "lake")
    attempts = refusals.try_everything(small)
    assert [(one.tried, one.message) for one in attempts if not one.refused or not one.unchanged] == []
    assert {one.kind for one in attempts} == {"bad SQL", "writing by SQL", "a scene's name", "a foreign file"}


def test_what_is_not_refused_and_what_changes_something_is_told(lake: Lake, tmp_path: Path) -> None:
    small = copied_lake(lake, tmp_path / "lake")
    allowed = refusals._refused(small, "bad SQL", "SELECT 1", lambda: query(small.snapshot(), "SELECT 1"))
    assert (allowed.refused, allowed.unchanged, allowed.message) == (False, True, None)
    written = refusals._refused(small, "bad SQL", "a file", lambda: (tmp_path / "lake" / "new").write_text(""))
    assert not written.unchanged

    def broken() -> None:
        raise KeyError("inside")

    assert not refusals._refused(small, "bad SQL", "a crash", broken).refused


@pytest.mark.slow
def test_the_command_prints_what_was_measured_and_fails_with_its_goals(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    some = {name: f"SELECT * FROM {name}" for name in ("headline", "volume_by_category", "objects_per_scene")}
    monkeypatch.setattr(report, "questions", lambda lake: some)
    arguments = ["warehouse", "--scale", "100", "--runs", "2", "--parts", "answers"]
    monkeypatch.setattr(report, "ANSWER_SECONDS", 1000.0)
    met = CliRunner().invoke(command, [*arguments, "--json"])
    assert met.exit_code == 0, met.output
    printed = json.loads(met.output)
    assert list(printed["lakes"]) == ["10", "100"]
    assert printed["lakes"]["100"]["rows"]["scenes"] == 100
    answers = {answer["name"]: answer for answer in printed["answers"]["100"]["answers"]}
    assert set(answers) == set(some)
    assert answers["objects_per_scene"]["rows"] == 100
    slowest = max(answers.values(), key=lambda answer: answer["seconds"])
    assert any(goal["found"] == slowest["seconds"] and slowest["name"] in goal["goal"] for goal in printed["goals"])

    monkeypatch.setattr(report, "ANSWER_SECONDS", 0.0)
    missed = CliRunner().invoke(command, arguments)
    assert missed.exit_code == 1, missed.output
    assert "MISSED" in missed.output
    assert all(name in missed.output for name in some)


def test_an_unknown_part_is_misuse(cache: Path) -> None:
    found = CliRunner().invoke(command, ["warehouse", "--parts", "answers,nothing"])
    assert found.exit_code == 2
    assert "nothing" in found.output


def test_without_pandas_the_benchmark_says_what_to_do(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="pip install pandas"):
        report.run_warehouse_bench(report.WarehouseBench(scenes=100, parts=("volumes",)), lambda what: None)


@pytest.mark.slow
def test_growth_is_measured_on_lakes_smaller_than_a_commit(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "_RUNS", 2)  # the second begins within the lake
    told: list[str] = []
    found = growth.growth(10, advance=told.append)
    assert found.scenes == 10
    assert found.rows == generated_lake(10).snapshot().arrow("instances").num_rows
    assert all(value > 0 for value in dataclasses.astuple(found))
    assert told[-1] == "one scene read"


def test_goals_follow_the_figures() -> None:
    seen = {"errors": [], "halves": 0, "mixed": 0, "lost": 1, "doubled": 0, "reads": 0, "in_commit": 1}
    measured = [{"neighbors_seconds": 0.1, "scattered_seconds": 0.6}]
    attempts = [{"refused": True, "unchanged": True}, {"refused": False, "unchanged": True}]
    goals = report.goals({"scenes": 1, "contention": seen, "growth": measured, "refusals": attempts})
    missed = {goal["goal"] for goal in goals if not goal["met"]}
    assert missed == {
        "contention: lost",
        "contention: snapshots that readers looked at",
        "replace 200 scenes of instances, scattered [s]",
        "attempts that were not refused",
    }


def test_every_table_but_those_about_the_lake_has_a_query() -> None:
    assert set(generator._queries()) == set(TABLES) - set(generator._ABOUT_THE_LAKE)
