"""Films and plans of robot runs in a lake: which ones are shown, and what they are made of."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flows.outputs.films import Filmed, each_written
from schemas.candidates import Asset
from schemas.capture import RoomSurface, Shell
from schemas.errors import InputError
from schemas.evaluation import Trajectory
from schemas.files import write_whole
from schemas.optimization import Placement
from schemas.record import arrow_to_rows
from schemas.robot import RobotRun
from warehouse.questions.quoting import listed
from warehouse.questions.views import asked_by

if TYPE_CHECKING:
    from tasks.films.drives import DrivePlan, FilmedRun
    from tasks.films.rooms import FilmedRoom
    from tasks.films.walks import FilmLook
    from warehouse.lake import Lake
    from warehouse.tables.snapshot import Reader

CART_M = 0.25
"""Height of a cart in films [m]: rows do not say how high it is, and the default one is so."""

_KEY = ("batch_id", "scene_id", "episode_id")


def shown_drives(per_outcome: int, which: str) -> str:
    """SQL of as many runs that arrived and that did not, of each policy's run and setup, drawn by a hash of the episode. `which`: a
    condition."""
    draw = "md5(scene_id || '/' || episode_id), scene_id, episode_id, batch_id"
    return f"""WITH judged AS (
    SELECT policy, run_name, setup, body, {", ".join(_KEY)}, outcome, outcome = 'arrived' AS has_arrived FROM current_robot_runs
    WHERE outcome <> 'unreachable' AND {which}
)
SELECT policy, run_name, setup, body, {", ".join(_KEY)}, outcome FROM judged
QUALIFY row_number() OVER (PARTITION BY policy, run_name, setup, body, has_arrived ORDER BY {draw}) <= {per_outcome}
ORDER BY policy, run_name, setup, body, has_arrived DESC, {draw}"""


def write_drive_films(
    lake: Lake, batches: Sequence[str], folder: Path, per_outcome: int, look: FilmLook | None = None,
    advance: Callable[[str], None] | None = None,
) -> Filmed:  # fmt: skip
    """Write films of runs of drive batches as WebP files into a folder, each whole or not at all.

    The same runs in the same scenes give the same bytes under the same names. A scene that cannot be drawn costs its films.
    """
    from tasks.films.walks import FilmLook

    look, reader = look or FilmLook(), lake.snapshot()
    sql = shown_drives(per_outcome, f"batch_id IN ({listed(batches)})")
    with reader.connect(names=asked_by(sql)) as connection:
        rows = connection.sql(sql).to_arrow_table().to_pylist()
    named = {folder / drive_film_name(row): row for row in rows}
    files, missing = each_written(named, lambda row, file: _write_film(lake, reader, row, look, file), advance)
    return Filmed(tuple(files), tuple(missing if rows else ["no run to film"]))


def drive_film_name(row: Mapping[str, Any]) -> str:
    """Name of a film: cart, policy, outcome, scene and episode, a different one for each."""
    from tasks.exports.bodies import digest, stem

    policy = re.sub(r"[^A-Za-z0-9_-]+", "-", row["policy"])[:40].strip("-")
    return f"cart_{policy}_{row['outcome']}_{stem(row['scene_id'])}_{row['episode_id']}_{digest(row['batch_id'])}.webp"


def _write_film(lake: Lake, reader: Reader, row: Mapping[str, Any], look: FilmLook, file: Path) -> None:
    """Write the film of a row of `shown_drives`."""
    from tasks.films.drives import drive_frames
    from tasks.films.reel import webp
    from tasks.films.third_person import ThirdPerson

    filmed, room, plan = filmed_drive(lake, reader, row, (look.room.height, look.room.height))
    data = webp(drive_frames(ThirdPerson(room, filmed, look.room), plan, filmed, look), len(filmed.steps), look)
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, data)


def filmed_drive(lake: Lake, reader: Reader, row: Mapping[str, Any], size: tuple[int, int]) -> tuple[FilmedRun, FilmedRoom, DrivePlan]:
    """The run of a row of `shown_drives`, its room as meshes, and its plan, so many pixels wide and high.

    Raises:
        InputError: the scene cannot be drawn.
    """
    import numpy as np
    import shapely

    from tasks.films.drives import DrivePlan, FilmedRun
    from tasks.films.rooms import filmed_room
    from tasks.geometry.meshes import surface_of
    from tasks.navigation.obstacles import footprint
    from tasks.robot.configuration import Cart
    from tasks.shell import floor_ring, interior_footprints

    scene = row["scene_id"]
    (run,) = arrow_to_rows(reader.matching("robot_runs", {name: [row[name]] for name in _KEY}), RobotRun)
    ways = reader.matching("trajectories", {"batch_id": [run.trajectory_batch_id], "scene_id": [scene], "episode_id": [run.episode_id]})
    poses = [way.poses for way in arrow_to_rows(ways, Trajectory)]
    shells, placements = reader.rows(Shell, scene), reader.rows(Placement, scene)
    if not shells:
        raise InputError(scene, "shells", "the scene has no room", "run capture on the scene again")
    assets = reader.rows_by_key(Asset, sorted({placement.asset_id for placement in placements}))
    room = filmed_room(shells[0], reader.rows(RoomSurface, scene), placements, assets, lake.blobs)
    way = np.array(poses[0] if poses else run.track, dtype=np.float64)[:, :2]
    filmed = FilmedRun(run, way, CART_M)
    outlines = [footprint(surface_of(parts), Cart().climb_m, CART_M) for parts in room.objects.values()]
    walls = [shapely.Polygon(corners) for corners in interior_footprints(shells[0])]
    plan = DrivePlan(filmed, shapely.Polygon(floor_ring(shells[0])), [*outlines, *walls], size)
    return filmed, room, plan
