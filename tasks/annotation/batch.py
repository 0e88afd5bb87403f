"""Annotation batches as JSON files: read, checked against `batch.schema.json`, refused with one line that says where."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.batches import BatchSchema, parse_json, read_limited
from tasks.geometry.transforms import flat, pose_from_quaternion_wxyz, yaw_pose

SCHEMA_FILE = Path(__file__).with_name("batch.schema.json")
"""The published JSON Schema of a batch file."""

SCHEMA = BatchSchema(SCHEMA_FILE)

MAX_FILE_BYTES = BUDGET.annotation_bytes
"""A hundred thousand answers take about 40 MB; a larger file is no batch that people filled in."""

MAX_FILES = 1000
"""Files of one batch: one per scene and annotator of a large study."""

MAX_NUMBER = 1e6
"""No coordinate of a room, no angle and no factor comes near; larger ones would lose the digits that matter."""

QUATERNION_TOLERANCE = 1e-3
"""How far from 1 the length of a quaternion may be: tools print four to six digits."""


@dataclasses.dataclass(frozen=True)
class AnnotatorAnswer:
    """One annotator's answer as the file has it. `where` is its JSON path in `source_file`.

    `choice` and `ranking` hold asset ids and slot numbers. `pose`: asset to world frame [m], 4x4 row by row; `scale`:
    along the asset's own axes; both None where the answer has no transform. `seconds`: time spent on the answer [s];
    None where nobody measured it. `is_withdrawn`: it takes the annotator's earlier answer back, and says nothing else.
    """

    scene_id: str
    instance_id: str
    annotator: str
    answered_at: datetime
    choice: str | int | None
    pose: tuple[float, ...] | None
    scale: tuple[float, ...] | None
    ranking: tuple[str | int, ...]
    source_file: str
    where: str
    seconds: float | None = None
    is_withdrawn: bool = False
    tool: str | None = None
    is_simulated: bool = False


@dataclasses.dataclass(frozen=True)
class AnnotationBatch:
    """A batch of answers, the outside input of the annotation stage. `is_dated`: every answer has a time of its own, and not that of
    the file that it was exported to."""

    batch_id: str
    annotations: tuple[AnnotatorAnswer, ...]
    is_dated: bool = True

    @property
    def scene_ids(self) -> tuple[str, ...]:
        """The scenes that the batch names, sorted."""
        return tuple(sorted({answer.scene_id for answer in self.annotations}))


def read_batch(path: Path) -> AnnotationBatch:
    """The batch in a JSON file and in the files that it names, in the order of the files.

    Raises:
        InputError: a file cannot be read, breaks the schema or names a file outside its own folder; an answer
            contradicts itself or is given twice; there is no answer at all. Names file and JSON path.
    """
    root = path.parent.resolve()
    if not path.is_file():
        raise InputError(str(path), "", "is no file", "name a JSON file with an annotation batch")
    answers: list[AnnotatorAnswer] = []
    batch_id = ""
    seen: set[Path] = set()
    queue = [path.resolve()]
    while queue:
        file = queue.pop(0)
        name = file.relative_to(root).as_posix() if file.is_relative_to(root) else file.name
        seen.add(file)
        document = parse_json(read_limited(file, name, MAX_FILE_BYTES), name)
        SCHEMA.check(document, name)
        if batch_id and document["batch_id"] != batch_id:
            raise InputError(
                name, "batch_id", f"is {document['batch_id']!r}, the batch is {batch_id!r}", "give all files of a batch one batch_id"
            )
        batch_id = document["batch_id"]
        tool = document.get("tool")
        answers += [_answer(item, name, f"annotations[{i}]", tool) for i, item in enumerate(document.get("annotations", ()))]
        for index, relative in enumerate(document.get("files", ())):
            target = _inside(file.parent, relative, name, f"files[{index}]")
            if target in seen or target in queue:
                raise InputError(name, f"files[{index}]", f"{relative!r} is named twice", "name every file once")
            if len(seen) + len(queue) >= MAX_FILES:
                raise InputError(name, "files", f"the batch has more than {MAX_FILES} files", "split the batch")
            queue.append(target)
    _refuse_none(answers, path.name)
    _refuse_repeats(answers)
    return AnnotationBatch(batch_id, tuple(answers))


def _inside(folder: Path, relative: str, name: str, where: str) -> Path:
    """The file that `relative` names, which must lie in `folder`, links followed."""
    parts = PurePosixPath(relative)
    if parts.is_absolute() or ".." in parts.parts or "\\" in relative or ":" in relative:
        raise InputError(name, where, f"{relative!r} leaves the folder of the batch", "give a path below it, with forward slashes")
    try:
        target = (folder / parts).resolve()
        inside, there = target.is_relative_to(folder.resolve()), target.is_file()
    except (OSError, ValueError, RuntimeError):  # too long, not encodable, links in a circle
        inside, there = True, False
    if not inside:
        raise InputError(name, where, f"{relative!r} is a link out of the folder of the batch", "put the file itself there")
    if not there:
        raise InputError(name, where, f"{relative!r:.200} is no file", "correct the path")
    return target


def read_answers(document: Any, name: str) -> AnnotationBatch:
    """The batch in a JSON value, as a page or another program hands it over; `name` is what errors call it. It names no files.

    Raises:
        InputError: as `read_batch`.
    """
    SCHEMA.check(document, name)
    if document.get("files"):
        raise InputError(name, "files", "are not read from here", "give the answers themselves")
    tool = document.get("tool")
    answers = [_answer(item, name, f"annotations[{i}]", tool) for i, item in enumerate(document.get("annotations", ()))]
    _refuse_none(answers, name)
    _refuse_repeats(answers)
    return AnnotationBatch(document["batch_id"], tuple(answers))


def _answer(item: Any, name: str, where: str, tool: str | None = None) -> AnnotatorAnswer:
    """One answer, after what a schema cannot say: times with a zone, rotations, and a choice that tops its ranking."""
    transform = item.get("transform")
    pose, scale = _placed(transform, name, f"{where}.transform") if transform is not None else (None, None)
    is_withdrawn = bool(item.get("withdrawn", False))
    choice, ranking = _whole(item.get("choice")), tuple(_whole(v) for v in item.get("ranking", ()))
    if len(set(ranking)) != len(ranking):
        raise InputError(name, f"{where}.ranking", "names a candidate twice", "rank every candidate once")
    if is_withdrawn and (choice is not None or ranking or transform is not None):
        raise InputError(name, f"{where}.withdrawn", "is true, and there is an answer", "leave choice, ranking and transform out")
    if choice is None and transform is not None:
        raise InputError(name, f"{where}.transform", "is given although nothing was chosen", "give a choice, or null for the transform")
    return AnnotatorAnswer(
        scene_id=item["scene_id"],
        instance_id=item["instance_id"],
        annotator=item["annotator"].strip(),
        answered_at=moment(item["answered_at"], name, f"{where}.answered_at"),
        choice=choice,
        pose=pose,
        scale=scale,
        ranking=ranking,
        source_file=name,
        where=where,
        seconds=None if item.get("seconds") is None else float(item["seconds"]),
        is_withdrawn=is_withdrawn,
        tool=item.get("tool") or tool,
        is_simulated=bool(item.get("simulated", False)),
    )


def _whole(value: Any) -> Any:
    """JSON has one kind of number: 3.0 is slot 3."""
    return int(value) if isinstance(value, float) else value


def moment(text: str, name: str, where: str) -> datetime:
    """The time in ISO 8601 text, in UTC.

    Raises:
        InputError: it is none, or has no zone.
    """
    try:
        time = datetime.fromisoformat(text)
        if time.tzinfo is not None:
            return time.astimezone(UTC)
    except (ValueError, OverflowError):
        pass
    raise InputError(name, where, f"{text!r:.60} is no time with a zone", "write ISO 8601, such as 2026-03-01T14:05:00Z")


def _placed(transform: Any, name: str, where: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Pose and scale of a transform."""
    turned = [key for key in ("yaw_degrees", "rotation_wxyz") if key in transform]
    if len(turned) != 1:
        problem = "has both yaw_degrees and rotation_wxyz" if turned else "has no rotation"
        raise InputError(name, where, problem, "give one of yaw_degrees and rotation_wxyz")
    for key in ("position", "scale", *turned):
        values = transform[key] if isinstance(transform[key], list) else [transform[key]]
        if max(abs(value) for value in values) > MAX_NUMBER:
            raise InputError(name, f"{where}.{key}", "holds too large a number", "give metres, degrees or factors")
    scale = tuple(float(v) for v in transform["scale"])
    if min(scale) <= 0:
        raise InputError(name, f"{where}.scale", f"holds {min(scale):g}", "give three factors above 0; nothing is mirrored")
    if turned == ["yaw_degrees"]:
        return flat(yaw_pose(math.radians(transform["yaw_degrees"]), transform["position"])), scale
    quaternion = [float(v) for v in transform["rotation_wxyz"]]
    length = math.hypot(*quaternion)
    if abs(length - 1.0) > QUATERNION_TOLERANCE:
        raise InputError(name, f"{where}.rotation_wxyz", f"has length {length:.4g}", "give a unit quaternion w, x, y, z")
    return flat(pose_from_quaternion_wxyz(quaternion, transform["position"])), scale


def _refuse_none(answers: Sequence[AnnotatorAnswer], name: str) -> None:
    if not answers:
        raise InputError(name, "annotations", "the batch has no answers", "give at least one answer, here or in a file named in files")


def _refuse_repeats(answers: Sequence[AnnotatorAnswer]) -> None:
    first: dict[tuple[str, str, str], AnnotatorAnswer] = {}
    for answer in answers:
        key = (answer.scene_id, answer.instance_id, answer.annotator)
        if key in first:
            other = first[key]
            problem = (
                f"{answer.annotator} answers for {answer.scene_id} {answer.instance_id} again, as in {other.source_file} {other.where}"
            )
            raise InputError(
                answer.source_file, answer.where, problem, "keep one answer per annotator and instance; correct an old one in a new batch"
            )
        first[key] = answer
