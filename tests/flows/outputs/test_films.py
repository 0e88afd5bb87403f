"""Films of a lake's trajectories: which are shown, what is written, and what people are told."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from PIL import Image

from flows.commands.evaluate import command
from flows.inputs.evaluation import import_trajectories, run_policy
from flows.outputs import films
from flows.outputs.films import LEAST_ACTIONS, camera_of, file_name, shown_walks, write_films
from flows.run.configuration import configure
from flows.stats import answers_of, write_report
from flows.stats.scenes import walk_strip_of
from schemas.errors import InputError
from schemas.evaluation import Trajectory
from schemas.navigation import Episode
from tasks.films.walks import FilmLook
from tasks.policy.model.config import AgentCamera
from tasks.stats.scenes import PictureConfig
from tests.flows.inputs.test_policies import keep_model
from tests.samples import sample
from tests.tasks.policy.policies import TINY
from tests.tasks.simulation.acted_scenes import STUDY, acted_lake
from warehouse.lake import Lake

pytestmark = pytest.mark.whole

LOOK = FilmLook(room=PictureConfig(width=160, height=120, oversampling=1), view_px=32, text_px=8)
MINE = ("mine", "checkpoint 3")


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """The study, and of a policy of somebody's three successes, two failures and one failure of a single action."""
    folder = tmp_path_factory.mktemp("films")
    lake = acted_lake(folder / "lake", (STUDY,))
    episodes = sorted(lake.snapshot().rows(Episode), key=lambda row: (-len(row.actions), row.episode_id))
    done = [list(row.actions) for row in episodes[:3]]
    done += [[*row.actions[:-1], *("left", "right") * LEAST_ACTIONS] for row in episodes[3:5]] + [["stop"]]
    document = {
        "batch_id": "mine-1", "policy": MINE[0], "run_name": MINE[1],
        "trajectories": [{"scene_id": row.scene_id, "episode_id": row.episode_id, "actions": actions}
                         for row, actions in zip(episodes[:6], done, strict=True)],
    }  # fmt: skip
    file = folder / "mine.json"
    file.write_text(json.dumps(document))
    import_trajectories(lake, file, configure())
    return lake


def drawn(lake: Lake, per_outcome: int) -> list[tuple[str, bool]]:
    with lake.snapshot().connect() as connection:
        rows = connection.sql(shown_walks(per_outcome, "policy = 'mine'")).to_arrow_table().to_pylist()
    return [(row["episode_id"], row["success"]) for row in rows]


@pytest.mark.slow
def test_successes_and_failures_are_drawn_by_the_episode_and_short_walks_come_last(lake: Lake) -> None:
    rows = {row.episode_id: row for row in lake.snapshot().rows(Trajectory)}
    every = drawn(lake, 9)
    assert [success for _, success in every] == [True] * 3 + [False] * 3
    assert len(rows[every[-1][0]].actions) == 1
    for count in (1, 2):
        assert drawn(lake, count) == every[:count] + every[3 : 3 + count]


def test_success_and_failure_are_filmed_with_every_pose_and_the_same_bytes_twice(lake: Lake, tmp_path: Path) -> None:
    done = write_films(lake, [MINE], tmp_path / "a", 1, LOOK)
    assert done.missing == ()
    assert ["_success_" in done.files[0].name, "_failure_" in done.files[1].name] == [True, True]
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == sorted(file.name for file in done.files)
    rows = {row.episode_id: row for row in lake.snapshot().rows(Trajectory)}
    for file, (episode, _) in zip(done.files, drawn(lake, 1), strict=True):
        with Image.open(file) as film:
            assert film.n_frames == len(rows[episode].poses) > LEAST_ACTIONS  # type: ignore[attr-defined]
    again = write_films(lake, [MINE], tmp_path / "b", 1, LOOK)
    assert [file.read_bytes() for file in again.files] == [file.read_bytes() for file in done.files]
    assert [file.name for file in again.files] == [file.name for file in done.files]


def test_who_has_no_trajectories_costs_nobody_else_a_film(lake: Lake, tmp_path: Path) -> None:
    done = write_films(lake, [MINE, ("expert", "built-in")], tmp_path / "films", 1, LOOK)
    assert len(done.files) == 2
    assert [line for line in done.missing if line.startswith("expert, built-in: no ")] == list(done.missing)
    assert len(done.missing) == 2
    nobody = write_films(lake, [("expert", "built-in")], tmp_path / "none", 1, LOOK)
    assert nobody.files == ()
    assert not (tmp_path / "none").exists()


def test_a_walk_that_cannot_be_drawn_costs_its_film_alone(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = films.scenes_of

    def torn(lake, reader, row, look):
        if row["success"]:
            raise InputError(row["scene_id"], "navmesh", "is gone", "run again")
        return whole(lake, reader, row, look)

    monkeypatch.setattr(films, "scenes_of", torn)
    done = write_films(lake, [MINE], tmp_path, 1, LOOK)
    assert ["_failure_" in file.name for file in done.files] == [True]
    assert len(done.missing) == 1
    assert done.missing[0].endswith("demo/study_00: navmesh: is gone; run again")


def test_a_film_that_was_interrupted_leaves_nothing(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(data: bytes) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("os.fsync", killed)
    with pytest.raises(KeyboardInterrupt):
        write_films(lake, [MINE], tmp_path, 1, LOOK)
    assert not list(tmp_path.rglob("*"))


def test_names_of_films_tell_runs_apart() -> None:
    row = {"policy": "a", "run_name": "seed 0", "success": True, "scene_id": "demo/room_00", "episode_id": "0003"}
    names = {file_name({**row, "run_name": name}) for name in ("seed 0", "seed-0", "seed/0", "../seed-0", "seed.0")}
    assert len(names) == 5
    assert not any("/" in name or ".." in name for name in names)
    assert "a_seed-0_success_demo_room_00_0003.webp" in names


def test_a_model_is_filmed_through_its_own_camera(lake: Lake) -> None:
    row = keep_model(lake)
    reader = lake.snapshot()
    mine = sample(Trajectory, policy="navigation", run_name=row.model_id[:12])
    assert camera_of(reader, mine) == TINY.camera
    assert camera_of(reader, dataclasses.replace(mine, run_name="f" * 12)) == AgentCamera()
    assert camera_of(reader, dataclasses.replace(mine, policy="mine")) == AgentCamera()


@pytest.mark.slow
def test_the_command_writes_films_and_says_where(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tasks.films.walks.FilmLook", lambda: LOOK)  # the size that people get takes ten times as long
    words = ["--policy", "expert", "--lake", lake.address, "--films", str(tmp_path / "films")]
    done = CliRunner().invoke(command, words)
    assert done.exit_code == 0, done.output
    (file,) = (tmp_path / "films").iterdir()
    assert str(file) in done.stdout.splitlines()
    assert "note: expert, built-in: no failure to film" in done.stderr
    told = CliRunner().invoke(command, [*words, "--per-outcome", "2", "--json"])
    assert Path(json.loads(told.stdout)["films"][0]).name == file.name
    assert len(list((tmp_path / "films").iterdir())) == 2
    refused = CliRunner().invoke(command, [*words, "--dry-run"])
    assert refused.exit_code == 2
    assert "--dry-run writes nothing" in refused.stderr


def test_the_report_shows_a_success_and_a_failure_of_each_policy(lake: Lake, tmp_path: Path) -> None:
    run_policy(lake, "expert", configure())
    reader = lake.snapshot()
    rows = answers_of(reader).rows["trajectory_metrics.shown"].to_pylist()
    assert [(row["policy"], row["success"]) for row in rows] == [("expert", True), ("mine", True), ("mine", False)]
    strips = [walk_strip_of(lake, reader.snapshot_id, row) for row in rows]
    assert [strip.outcome for strip in strips] == ["success", "success", "failure"]
    for strip in strips:
        with Image.open(io.BytesIO(strip.picture)) as image:
            assert (image.format, image.width) == ("JPEG", 4 * 300 + 3 * 8)
        assert len(strip.picture) < 100_000
    text = write_report(lake, tmp_path / "report.html", workers=1, look=PictureConfig(width=60, height=42, oversampling=1)).path.read_text()
    assert text.count('<figure class="walk">') == 3
    assert 'mark-failure">failure</strong> mine, checkpoint 3: go to the' in text
