"""The commands as a shell sees them: what they print, in which form, and with which exit code."""

from __future__ import annotations

import csv
import importlib
import io
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import click
import pyarrow.parquet as pq
import pytest

from flows.cli import COMMANDS, MODULES
from tasks.pipeline import SCENE_STAGES
from tests.flows.outputs.test_export_folder import SCENES, built
from tests.test_pipeline import metascenes
from warehouse.lake import Lake

pytestmark = pytest.mark.whole

Ask = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, str], Path, Path]:
    """Environment, scans and lake, shared with the tests of exports. Tests that change the lake take a copy."""
    return built(tmp_path_factory)


@pytest.fixture(scope="module")
def lake(place: tuple[dict[str, str], Path, Path]) -> Path:
    return place[2]


@pytest.fixture(scope="module")
def ask(place: tuple[dict[str, str], Path, Path]) -> Ask:
    """Runs a command as a process, as a shell does."""

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        return metascenes(place[0], *arguments, timeout=600)

    return run


def one_line(done: subprocess.CompletedProcess[str], code: int = 2) -> str:
    """What a command said on standard error: a line, and nothing that looks like a traceback."""
    assert done.returncode == code, done.stderr + done.stdout
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    return lines[0]


def every_command() -> list[tuple[str, ...]]:
    """Words of every command and subcommand, the group itself first."""
    found: list[tuple[str, ...]] = [()]
    for name in COMMANDS:
        command = importlib.import_module(f"flows.commands.{MODULES.get(name, name)}").command
        found.append((name,))
        if isinstance(command, click.Group):
            found += [(name, inner) for inner in command.commands]
    return found


@pytest.mark.parametrize("words", every_command(), ids=lambda words: " ".join(words) or "metascenes")
def test_help_of_every_command_has_an_example_of_that_command(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    from flows.cli import cli

    for option in ("--help", "-h"):
        with pytest.raises(SystemExit) as end:
            cli([*words, option], prog_name="metascenes")
        assert end.value.code == 0
        said = " ".join(capsys.readouterr().out.split())
        assert f"Example: {' '.join(['metascenes', *words])}" in said
        assert said.startswith(f"Usage: {' '.join(['metascenes', *words])}")


def test_the_list_of_commands_says_what_each_says_of_itself() -> None:
    for name, line in COMMANDS.items():
        command = importlib.import_module(f"flows.commands.{MODULES.get(name, name)}").command
        assert command.name == name
        assert command.short_help == line or (command.help or "").split("\n")[0] == line


def test_help_and_version_answer_without_the_heavy_packages() -> None:
    code = (
        "import sys; from flows.cli import cli\n"
        "try: cli(['--help'], prog_name='metascenes')\nexcept SystemExit as end: assert end.code == 0\n"
        "print('heavy:', sorted({'prefect', 'duckdb', 'deltalake', 'numpy', 'pyarrow', 'pxr', 'numba'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "heavy: []"
    assert all(name in done.stdout for name in COMMANDS)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["nosuch"], "nosuch"),
        (["staus"], "Did you mean 'status'?"),
        (["lake", "vacum"], "Did you mean 'vacuum'?"),
        (["run", "--scan", "x"], "--scans"),
        (["status", "--nosuch"], "--nosuch"),
        (["run"], "--scans"),
        (["run", "--scans", "x", "--format", "nosuch"], "nosuch"),
        (["run", "--scans", "x", "--workers", "0"], "--workers"),
        (["sql", "SELECT 1", "--output", "xml"], "xml"),
        (["sql", "SELECT 1", "--file", "x.sql"], "--file"),
        (["sql", "--out", "x.csv"], "--out"),
        (["sql", "SELECT 1", "--attach", "weights.csv"], "weights.csv is not NAME=FILE"),
        (["sql", "SELECT 1", "--attach", "w=a.csv", "--attach", "w=b.csv"], "names w twice"),
        (["export"], "--out"),
        (["doctor", "usd", "absent.usda"], "absent.usda"),
        (["doctor", "habitat", "absent"], "absent"),
    ],
)
def test_misuse_is_exit_code_2_and_names_what_is_wrong(
    arguments: list[str], named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from flows.cli import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["metascenes", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert named in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [], "misuse leaves nothing behind"


def test_status_says_that_everything_is_done(ask: Ask, lake: Path) -> None:
    done = ask("status", "--lake", lake)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"{len(SCENES)} done\n"
    told = json.loads(ask("status", "--lake", lake, "--json").stdout)
    assert told == {
        "counts": {"done": len(SCENES), "running": 0, "failed": 0, "stale": 0, "unfinished": 0},
        "seconds_left": 0,
        "running": [],
        "todo": {},
        "runs": [],
        "scenes": {scene: {stage.name: "done" for stage in SCENE_STAGES} for scene in SCENES},
        "errors": [],
        "broken_checks": [],
        "same": [],
        "refused": [],
    }


def test_stage_times_have_a_line_per_stage(ask: Ask, lake: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = ask("stats", "--stages", "--lake", lake)
    assert (done.returncode, done.stderr) == (0, "")
    lines = {words[0]: words[1:] for words in map(str.split, done.stdout.splitlines())}
    assert [name for name in lines if name in {stage.name for stage in SCENE_STAGES}] == [stage.name for stage in SCENE_STAGES]
    with Lake.open(str(lake)).snapshot().connect() as connection:
        seconds = dict(connection.execute("SELECT stage, sum(seconds) FROM stage_runs GROUP BY stage").fetchall())
    for stage in SCENE_STAGES:
        assert int(lines[stage.name][0]) == len(SCENES)
        assert int(lines[stage.name][1]) == len(SCENES)
        assert float(lines[stage.name][2]) == pytest.approx(seconds[stage.name], abs=0.02)
    assert list(tmp_path.iterdir()) == [], "no report is written"


QUESTION = "SELECT scene_id, instance_id, category, box_volume_m3 FROM instances ORDER BY ALL"


def test_answers_in_every_form_say_the_same(ask: Ask, place: tuple[dict[str, str], Path, Path], lake: Path) -> None:
    with Lake.open(str(lake)).snapshot().connect() as connection:
        expected = connection.execute(QUESTION).fetchall()
    names = ["scene_id", "instance_id", "category", "box_volume_m3"]
    assert len(expected) > len(SCENES)
    told = json.loads(ask("sql", QUESTION, "--lake", lake, "--output", "json").stdout)
    assert told == [dict(zip(names, row, strict=True)) for row in expected]
    rows = list(csv.reader(io.StringIO(ask("sql", QUESTION, "--lake", lake, "--output", "csv").stdout)))
    assert rows[0] == names
    assert [(*row[:3], float(row[3]) if row[3] else None) for row in rows[1:]] == expected
    command = [sys.executable, "-m", "flows.cli", "sql", QUESTION, "--lake", str(lake), "--output", "parquet"]
    raw = subprocess.run(command, env=place[0], capture_output=True, timeout=600)
    assert (raw.returncode, raw.stderr) == (0, b"")
    table = pq.read_table(io.BytesIO(raw.stdout))
    assert table.column_names == names
    assert [tuple(row.values()) for row in table.to_pylist()] == expected
    text = ask("sql", QUESTION, "--lake", lake).stdout
    assert all(category in text for _, _, category, _ in expected)


def test_values_that_need_quoting_come_back_from_csv(ask: Ask, lake: Path) -> None:
    statement = "SELECT 'a,b' AS x, 'say \"no\"' AS y, 'two' || chr(10) || 'lines' AS z, NULL AS n"
    rows = list(csv.reader(io.StringIO(ask("sql", statement, "--lake", lake, "--output", "csv").stdout)))
    assert rows == [["x", "y", "z", "n"], ["a,b", 'say "no"', "two\nlines", ""]]


def test_a_question_that_cannot_be_asked_is_one_line(ask: Ask, lake: Path) -> None:
    assert "nosuch" in one_line(ask("sql", "SELECT nosuch FROM scenes", "--lake", lake))
    assert "snapshot" in one_line(ask("sql", "SELECT 1", "--lake", lake, "--snapshot", 99))


@pytest.mark.parametrize(
    "command", [("status",), ("sql", "SELECT 1"), ("stats", "--stages"), ("doctor", "lake"), ("export", "--out", "OUT")]
)
def test_a_lake_that_is_not_there_is_one_line_and_is_not_made(ask: Ask, tmp_path: Path, command: tuple[str, ...]) -> None:
    absent = tmp_path / "absent"
    words = [str(tmp_path / "out") if word == "OUT" else word for word in command]
    assert "absent" in one_line(ask(*words, "--lake", absent))
    assert list(tmp_path.iterdir()) == []


def test_doctor_finds_a_lake_sound_and_a_damaged_one_not(ask: Ask, lake: Path, tmp_path: Path) -> None:
    sound = ask("doctor", "lake", "--lake", lake)
    assert (sound.returncode, sound.stderr) == (0, "")
    assert "0 errors" in sound.stdout
    copy = tmp_path / "lake"
    shutil.copytree(lake, copy)
    from warehouse.tables.digest import blob_names

    changed, lost = sorted(blob_names(Lake.open(str(copy)).snapshot()))[:2]
    for name, content in ((changed, b"other bytes"), (lost, None)):
        file = next((copy / "blobs").rglob(name))
        file.chmod(0o644)
        file.unlink()
        if content is not None:
            file.write_bytes(content)
    told = ask("doctor", "lake", "--lake", copy, "--json")
    assert told.returncode == 1
    errors = json.loads(told.stdout)["errors"]
    assert len(errors) == 2
    assert any(changed in line and "differs" in line for line in errors)
    assert any(lost in line and "missing" in line for line in errors)


@pytest.mark.slow
def test_doctor_finds_an_export_sound_and_a_damaged_one_not(ask: Ask, lake: Path, tmp_path: Path) -> None:
    said = ask("export", "--lake", lake, "--out", tmp_path, "--json")
    assert said.returncode == 0, said.stderr
    told = json.loads(said.stdout)
    assert told["findings"] == []
    scene = told["usd_scenes"][0]
    model = next((tmp_path / "mjcf").glob("*/scene.xml"))
    robots = next((tmp_path / "urdf").glob("*/poses.json")).parent
    binary = next((tmp_path / "glb").glob("*.glb"))
    chart = next((tmp_path / "nav2").glob("*/map.yaml"))
    world = next((tmp_path / "sdf").glob("*/world.sdf"))
    asked = (
        ("usd", scene), ("habitat", tmp_path / "habitat"), ("mjcf", model), ("urdf", robots), ("glb", binary), ("nav2", chart),
        ("sdf", world),
    )  # fmt: skip
    for words in asked:
        done = ask("doctor", *words)
        assert done.returncode == 0, done.stdout
        assert "0 errors" in done.stdout
    shutil.rmtree(Path(scene).parent / "room")
    next((tmp_path / "habitat").rglob("*.navmesh")).unlink()
    next(model.parent.rglob("*.obj")).unlink()
    next(robots.rglob("*.obj")).unlink()
    next(chart.parent.glob("*.pgm")).unlink()
    next(world.parent.rglob("*.obj")).unlink()
    binary.write_bytes(binary.read_bytes()[:1000])
    for words in asked:
        done = ask("doctor", *words, "--json")
        assert done.returncode == 1, done.stdout + done.stderr
        assert json.loads(done.stdout)["errors"]


def test_doctor_says_of_a_file_that_is_no_usd_that_it_is_none(ask: Ask, tmp_path: Path) -> None:
    file = tmp_path / "scene.usda"
    file.write_text("no usd at all")
    done = ask("doctor", "usd", file, "--json")
    assert done.returncode in (1, 2)
    assert "Traceback" not in done.stderr
    assert "scene.usda" in done.stdout + done.stderr


def test_scans_that_are_not_there_are_misuse(ask: Ask, tmp_path: Path) -> None:
    line = one_line(ask("run", "--scans", tmp_path / "nosuch", "--lake", tmp_path / "lake"))
    assert "nosuch" in line
    assert "does not exist" in line
    assert list(tmp_path.iterdir()) == []


def test_a_config_file_with_a_seed_and_a_bad_setting_reach_the_run(
    ask: Ask, place: tuple[dict[str, str], Path, Path], tmp_path: Path
) -> None:
    _, scans, lake = place
    file = tmp_path / "stages.toml"
    file.write_text("seed = 5\n")
    dry = ("run", "--scans", scans, "--lake", lake, "--dry-run", "--json")
    seeded = ask(*dry, "--config", file)
    assert seeded.returncode == 0, seeded.stderr
    assert seeded.stdout == ask(*dry, "--seed", 5).stdout
    told = json.loads(seeded.stdout)
    assert told["counts"] == {"run": len(SCENES) * len(SCENE_STAGES)}
    assert all("seed" in step["why"] for step in told["steps"] if step["stage"] == SCENE_STAGES[0].name)
    won = ask(*dry, "--config", file, "--seed", 0)
    assert won.stdout == ask(*dry).stdout, "the option wins over the file"
    assert not any("seed" in step["why"] for step in json.loads(won.stdout)["steps"])
    assert "navigation.max_step" in one_line(ask(*dry, "--set", "navigation.max_step=1"))


def test_a_dry_export_writes_nothing_and_counts_what_is_written(ask: Ask, lake: Path, tmp_path: Path) -> None:
    words = ("export", "--lake", lake, "--out", tmp_path, "--format", "usd", "--scene", SCENES[0])
    dry = json.loads(ask(*words, "--dry-run", "--json").stdout)
    assert list(tmp_path.iterdir()) == []
    assert json.loads(ask(*words, "--json").stdout)["files"] == dry["files"] > 0
