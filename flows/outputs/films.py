"""Films of trajectories in a lake: which ones are shown, and what they are made of."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from schemas.candidates import Asset
from schemas.capture import RoomSurface, Shell
from schemas.errors import InputError, LakeError
from schemas.evaluation import Trajectory
from schemas.files import write_whole
from schemas.navigation import Navmesh
from schemas.optimization import Placement
from schemas.record import arrow_to_rows
from warehouse.questions.quoting import listed
from warehouse.questions.views import asked_by

if TYPE_CHECKING:
    from tasks.films.rooms import FilmedRoom
    from tasks.films.walks import FilmedWalk, FilmLook
    from tasks.policy.model.config import AgentCamera
    from tasks.simulation.world import World
    from warehouse.lake import Lake
    from warehouse.tables.snapshot import Reader


LEAST_ACTIONS = 8
"""Shorter walks show little."""


@dataclasses.dataclass(frozen=True)
class Filmed:
    """Films that were written. missing: What was not filmed, and why, a line each."""

    files: tuple[Path, ...] = ()
    missing: tuple[str, ...] = ()


def shown_walks(per_outcome: int, which: str) -> str:
    """SQL of as many successes and failures of each run of a policy, drawn by a hash of the episode: runs in the same episodes are shown
    in the same ones. Walks of less than `LEAST_ACTIONS` come after all others. Left out is what was measured again, or in an episode
    that is there no more. `which`: a condition.
    """
    draw = f"episode_length < {LEAST_ACTIONS}, md5(scene_id || '/' || episode_id), scene_id, episode_id"
    return f"""WITH counted AS (
    SELECT policy, run_name, batch_id, scene_id, episode_id, success, episode_length FROM trajectory_metrics
    WHERE is_counted AND NOT is_outdated AND {which}
    QUALIFY row_number() OVER (PARTITION BY policy, run_name, scene_id, episode_id, success ORDER BY success_distance_m, batch_id) = 1
)
SELECT policy, run_name, batch_id, scene_id, episode_id, success FROM counted
QUALIFY row_number() OVER (PARTITION BY policy, run_name, success ORDER BY {draw}) <= {per_outcome}
ORDER BY policy, run_name, success DESC, {draw}"""


def write_films(
    lake: Lake, runs: Sequence[tuple[str, str]], folder: Path, per_outcome: int, look: FilmLook | None = None,
    advance: Callable[[str], None] | None = None,
) -> Filmed:  # fmt: skip
    """Write films of successes and failures of runs, by policy and name, as WebP files into a folder, each whole or not at all.

    The same trajectories in the same scenes give the same bytes under the same names. A scene that cannot be drawn costs its films, and
    a run without trajectories its own.
    """
    from tasks.films.walks import FilmLook

    look, reader = look or FilmLook(), lake.snapshot()
    rows: list[dict[str, Any]] = []
    asked = [shown_walks(per_outcome, f"(policy, run_name) = ({listed(run)})") for run in runs]
    with reader.connect(names=asked_by("trajectory_metrics")) as connection:
        for sql in asked:
            rows += connection.sql(sql).to_arrow_table().to_pylist()
    missing = []
    for policy, run_name in runs:
        outcomes = {row["success"] for row in rows if (row["policy"], row["run_name"]) == (policy, run_name)}
        missing += [f"{policy}, {run_name}: no {name} to film" for is_success, name in _NAMES.items() if is_success not in outcomes]
    named = {folder / file_name(row): row for row in rows}
    files, unmade = each_written(named, lambda row, file: write_whole_film(lake, reader, row, look, file), advance)
    return Filmed(tuple(files), (*missing, *unmade))


def each_written(
    rows: Mapping[Path, dict[str, Any]], write: Callable[[dict[str, Any], Path], None], advance: Callable[[str], None] | None
) -> tuple[list[Path], list[str]]:
    """Write a film of each row into its file; the files that were written, and why others were not, a line each."""
    files, missing = [], []
    for file, row in rows.items():
        try:
            write(row, file)
            files.append(file)
        except LakeError as error:
            missing.append(f"{file.name}: {error}")
        if advance is not None:
            advance(file.stem)
    return files, missing


_NAMES = {True: "success", False: "failure"}


def file_name(row: Mapping[str, Any]) -> str:
    """Name of a film: policy, run, outcome, scene and episode, a different one for each."""
    from tasks.exports.bodies import digest, stem

    plain = [re.sub(r"[^A-Za-z0-9_-]+", "-", row[name])[:40].strip("-") for name in ("policy", "run_name")]
    if plain != [row["policy"], row["run_name"]]:
        plain.append(digest(f"{row['policy']}\0{row['run_name']}"))
    return "_".join([*plain, _NAMES[row["success"]], stem(row["scene_id"]), row["episode_id"]]) + ".webp"


def write_whole_film(lake: Lake, reader: Reader, row: Mapping[str, Any], look: FilmLook, file: Path) -> None:
    """Write the film of a row of `shown_walks`."""
    from tasks.films.first_person import first_person
    from tasks.films.frames import frames
    from tasks.films.reel import webp
    from tasks.films.third_person import ThirdPerson

    walk, room, world = scenes_of(lake, reader, row, look)
    shots = frames(ThirdPerson(room, walk, look.room), first_person(world, walk.poses, walk.camera), walk, look)
    data = webp(shots, len(walk.poses), look)
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, data)


def scenes_of(lake: Lake, reader: Reader, row: Mapping[str, Any], look: FilmLook) -> tuple[FilmedWalk, FilmedRoom, World]:
    """The trajectory of a row of `shown_walks`, its room as meshes, and its scene as the agent meets it.

    Raises:
        InputError: the scene lacks what an agent needs, or cannot be drawn.
    """
    from flows.simulation.scenes import Worlds
    from tasks.evaluation.configuration import EvaluationConfig
    from tasks.films.rooms import filmed_room
    from tasks.films.walks import FilmedWalk

    scene = row["scene_id"]
    (trajectory,) = arrow_to_rows(
        reader.matching("trajectories", {name: [row[name]] for name in ("batch_id", "scene_id", "episode_id")}), Trajectory
    )
    world = Worlds(lake, reader, trajectory.agent, EvaluationConfig().reach_m).world(scene)
    (navmesh,) = (mesh for mesh in reader.rows(Navmesh, scene) if mesh.agent == trajectory.agent)
    shells, placements = reader.rows(Shell, scene), reader.rows(Placement, scene)
    assets = reader.rows_by_key(Asset, sorted({placement.asset_id for placement in placements}))
    room = filmed_room(shells[0] if shells else None, reader.rows(RoomSurface, scene), placements, assets, lake.blobs)
    camera = camera_of(reader, trajectory)
    camera = dataclasses.replace(camera, width=look.view_px, height=max(1, round(look.view_px * camera.height / camera.width)))
    return FilmedWalk(trajectory, row["success"], navmesh.agent_radius_m, navmesh.agent_height_m, camera), room, world


def camera_of(reader: Reader, trajectory: Trajectory) -> AgentCamera:
    """What an agent saw through: a model's own camera; the simulator's for all others, of which nobody says what theirs is."""
    from flows.inputs.policies import SYSTEM
    from flows.training.models import found_model
    from tasks.policy.model.config import AgentCamera, config_from

    if trajectory.policy != SYSTEM:
        return AgentCamera()
    try:
        row, _ = found_model(reader, trajectory.run_name, SYSTEM)
        return config_from(row.config).camera
    except InputError:  # erased or not of this lake: its way is there all the same
        return AgentCamera()
