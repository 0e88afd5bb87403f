"""Trajectory batches as JSON or JSON Lines files: read, checked against `batch.schema.json`, refused with one line that says where."""

from __future__ import annotations

import dataclasses
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.evaluation import ACTIONS
from schemas.parsing import weigh_json
from tasks.batches import BatchSchema, parse_json, read_limited
from tasks.geometry.transforms import pose_from_quaternion_wxyz, to_z_up, yaw_of

SCHEMA_FILE = Path(__file__).with_name("batch.schema.json")
"""The published JSON Schema of a batch file."""

SCHEMA = BatchSchema(SCHEMA_FILE)

MAX_FILE_BYTES = BUDGET.trajectories_bytes
"""Fifty thousand trajectories of 60 poses take about 200 MB; more go into batches of one run."""

MAX_NUMBER = 1e6
"""No coordinate of a room comes near; larger ones would lose the digits that matter."""

QUATERNION_TOLERANCE = 1e-3
"""How far from 1 the length of a quaternion may be: programs print four to six digits."""

LEVEL_TOLERANCE = 1e-2
"""How far an agent's up axis may lean, as the sine of the angle: it stands upright, a camera's rotation does not."""

_HABITAT_ACTIONS = {"move_forward": "forward", "turn_left": "left", "turn_right": "right"}

_NUMBERS = {"poses": 3, "positions": 3, "rotations": 4}

_LINE_BYTES = 96
"""Memory behind a line of JSON Lines, whatever is on it; an empty one takes time alone."""

Pose = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Attempt:
    """An episode as a policy carried it out.

    poses: x, y [m] and yaw about +Z [rad] before the first action and after every action, world frame; None: not recorded.
    collisions: Forward steps that met an obstacle; None: not recorded. where: Its place in the file, for messages.
    """

    scene_id: str
    episode_id: str
    actions: tuple[str, ...]
    poses: tuple[Pose, ...] | None
    collisions: int | None
    where: str


@dataclasses.dataclass(frozen=True)
class TrajectoryBatch:
    """One policy's attempts, the outside input of the evaluation stage. `source_file` is None for built-in policies."""

    batch_id: str
    policy: str
    run_name: str
    attempts: tuple[Attempt, ...]
    source_file: str | None = None

    @property
    def scene_ids(self) -> tuple[str, ...]:
        """The scenes that the batch names, sorted."""
        return tuple(sorted({attempt.scene_id for attempt in self.attempts}))


def read_batch(path: Path) -> TrajectoryBatch:
    """The batch in a JSON file, or in a JSON Lines file (`.jsonl`, `.ndjson`) whose first line is the batch without trajectories.

    Raises:
        InputError: the file cannot be read or breaks the schema; a trajectory contradicts itself or is given twice; there
            is none. Names file and place: the JSON path, or the line.
    """
    name = path.name
    if not path.is_file():
        raise InputError(str(path), "", "is no file", "name a JSON or JSON Lines file with a trajectory batch")
    raw = read_limited(path, name, MAX_FILE_BYTES)
    if path.suffix.lower() not in (".jsonl", ".ndjson"):
        return parse_batch(parse_json(raw, name), name)
    try:
        weigh_json(raw, a_line=_LINE_BYTES)
    except ValueError as error:
        raise InputError(name, "", str(error), "split the batch into files") from error
    lines = ((number, line) for number, line in enumerate(io.BytesIO(raw), start=1) if line.strip())
    first, head = next(lines, (1, b"null"))
    document = parse_json(head, name, first)
    if not isinstance(document, dict) or "trajectories" in document:
        raise InputError(name, "line 1", "is not the batch without its trajectories", "begin with batch_id, policy and frame in one object")
    SCHEMA.check({**document, "trajectories": []}, name, lambda path: f"line {first}{f': {path}' if path else ''}")
    return _batch(document, (_line(line, document, name, number) for number, line in lines), name)


def parse_batch(document: Any, name: str = "batch.json") -> TrajectoryBatch:
    """The batch in one JSON document that is in memory.

    Raises:
        InputError: as `read_batch`.
    """
    SCHEMA.check(_shortened(document), name)
    frame = document.get("frame", "world")
    items = enumerate(document["trajectories"])
    return _batch(document, (_attempt(item, frame, name, f"trajectories[{i}]") for i, item in items), name)


def _line(line: bytes, head: Mapping[str, Any], name: str, number: int) -> Attempt:
    """The trajectory in a line of JSON Lines, checked before the next one is read."""
    item = parse_json(line, name, number)

    def place(json_path: str) -> str:
        inner = json_path.partition("]")[2].removeprefix(".")
        return f"line {number}{f': {inner}' if inner else ''}"

    SCHEMA.check({**head, "trajectories": [_short(item)]}, name, place)
    return _attempt(item, head.get("frame", "world"), name, f"line {number}")


def _batch(head: Mapping[str, Any], given: Iterable[Attempt], name: str) -> TrajectoryBatch:
    attempts = tuple(given)
    if not attempts:
        raise InputError(name, "trajectories", "the batch has no trajectories", "give at least one")
    first: dict[tuple[str, str], Attempt] = {}
    for attempt in attempts:
        other = first.setdefault((attempt.scene_id, attempt.episode_id), attempt)
        if other is not attempt:
            problem = f"names {attempt.scene_id} {attempt.episode_id} again, as {other.where}"
            raise InputError(name, attempt.where, problem, "keep one trajectory per episode; a second run is a batch of its own")
    return TrajectoryBatch(
        batch_id=head["batch_id"],
        policy=head["policy"].strip(),
        run_name=head.get("run_name", head["batch_id"]).strip(),
        attempts=attempts,
        source_file=name,
    )


def _shortened(document: Any) -> Any:
    """A document with long lists that are plainly right cut to their first items: a schema takes 10 microseconds for every number."""
    if not isinstance(document, dict) or not isinstance(document.get("trajectories"), list):
        return document
    return {**document, "trajectories": [_short(item) for item in document["trajectories"]]}


def _short(item: Any) -> Any:
    if not isinstance(item, dict):
        return item
    short = dict(item)
    for key, width in _NUMBERS.items():
        rows = item.get(key)
        if isinstance(rows, list) and all(
            type(row) is list and len(row) == width and all(type(v) is float or type(v) is int for v in row) for row in rows
        ):
            short[key] = rows[:1]
    actions = item.get("actions")
    if isinstance(actions, list) and all(type(a) is str and (a in ACTIONS or a in _HABITAT_ACTIONS) for a in actions):
        short["actions"] = actions[:1]
    return short


def _attempt(item: Any, frame: str, name: str, where: str) -> Attempt:
    """One trajectory, after what a schema cannot say: an end at stop, one pose more than actions, numbers of a room."""
    actions = tuple(_HABITAT_ACTIONS.get(action, action) for action in item["actions"])
    if "stop" in actions[:-1]:
        problem = f"has an action after the stop at {actions.index('stop')}"
        raise InputError(name, f"{where}.actions", problem, "end the trajectory with its first stop")
    given = [key for key in _NUMBERS if key in item]
    wanted = ["poses"] if frame == "world" else ["positions", "rotations"]
    if given and given != wanted:
        problem = f"has {' and '.join(given)}, frame {frame!r} has {' and '.join(wanted)}"
        raise InputError(name, where, problem, 'give what the frame has, or the frame ("world" or "habitat") that was used')
    for key in given:
        if len(item[key]) != len(actions) + 1:
            problem = f"has {len(item[key])} rows for {len(actions)} actions"
            raise InputError(name, f"{where}.{key}", problem, "give one before the first action and one after every action")
        if max(abs(v) for row in item[key] for v in row) > MAX_NUMBER:
            raise InputError(name, f"{where}.{key}", "holds too large a number", "give metres and radians")
    poses = None
    if given:
        poses = _world(item["poses"]) if frame == "world" else _from_habitat(item["positions"], item["rotations"], name, where)
    collisions, steps = item.get("collisions"), actions.count("forward")
    if collisions is not None and collisions > steps:
        problem = f"is more than the {steps} forward steps"
        raise InputError(name, f"{where}.collisions", problem, "count the forward steps that met an obstacle")
    return Attempt(item["scene_id"], item["episode_id"], actions, poses, None if collisions is None else int(collisions), where)


def _world(rows: Sequence[Sequence[float]]) -> tuple[Pose, ...]:
    return tuple((float(x), float(y), float(yaw)) for x, y, yaw in rows)


def _from_habitat(positions: Sequence[Sequence[float]], rotations: Sequence[Sequence[float]], name: str, where: str) -> tuple[Pose, ...]:
    """Poses in the world frame of an agent in Habitat's, which looks along -Z: +Y once it is turned into the world frame."""
    poses = []
    for index, (position, (x, y, z, w)) in enumerate(zip(positions, rotations, strict=True)):
        length = math.sqrt(x * x + y * y + z * z + w * w)
        if abs(length - 1.0) > QUATERNION_TOLERANCE:
            problem = f"has length {length:.4g}"
            raise InputError(name, f"{where}.rotations[{index}]", problem, "give a unit quaternion x, y, z, w")
        pose = to_z_up(pose_from_quaternion_wxyz((w, x, y, z), position))
        if math.hypot(pose[0, 2], pose[1, 2]) > LEVEL_TOLERANCE or pose[2, 2] < 0:
            problem = "is not upright"
            raise InputError(name, f"{where}.rotations[{index}]", problem, "give the agent's rotation as x, y, z, w, not the camera's")
        yaw = math.remainder(yaw_of(pose) + 0.5 * math.pi, 2 * math.pi)
        poses.append((float(pose[0, 3]), float(pose[1, 3]), float(yaw)))
    return tuple(poses)
