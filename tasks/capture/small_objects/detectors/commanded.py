"""A detector that is a program of others, in a process of its own: a script around Ultralytics' YOLO, whose license keeps it out of ours.

It is called for each picture by a command line with {image}, a PNG file, {names}, what is looked for with commas between, and {out}, the
JSON file that it writes: `boxes` x0, y0, x1, y1 [px], `labels`, `scores` from 0 to 1, and, where it draws them, `masks` as run lengths
of COCO: `{"size": [height, width], "counts": [...]}`, column by column, the first run outside of the mask.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from schemas.machine.scratch import temporary_folder
from schemas.parsing import json_value
from schemas.text import one_line
from tasks.calls.command import CommandFailed, filled, places_in, run_command, words_of
from tasks.capture.small_objects.detectors.detector import WHERE, Array, Bools, Detections, DetectionSelection, selected
from tasks.settings import Positive, Share
from tasks.views.pictures import png_of
from tasks.vision.devices import NetworkPlacement
from tasks.vision.pixels import Image

PLACES = ("image", "names", "out")
"""What stands in braces in a command line."""

ANSWER = "found.json"
"""The file that a program writes, as errors name it."""

MOST_FOUND = 10_000
"""Boxes that an answer may have; detectors end at some hundreds."""

MOST_LETTERS = 60
"""Of a label."""


@dataclasses.dataclass(frozen=True)
class CommandedDetector(DetectionSelection):
    """Boxes, and masks where it has them, by a program that is called for every picture."""

    kind: ClassVar[str] = "command"
    command: str = ""  # a command line with {image}, {names} and {out}; quoted as a shell has it, but none runs it
    model: str = ""  # its name, as rows have it
    model_version: str = ""  # where the same name finds other things today than it did
    draws_masks: bool = False  # whether its answers have masks; else a segmenter draws them
    threshold: Share = 0.25  # of what it is sure of; as Ultralytics publishes it
    timeout_seconds: Positive = 300.0  # for a picture; loading the weights takes most of it
    version: str = "1"  # goes up when the same answer would give other boxes


class CommandDetector:
    """A program that detects. It finds what it is asked for where its command line says {names}, and else what it knows."""

    placement: NetworkPlacement | None = None

    def __init__(self, settings: CommandedDetector) -> None:
        self.settings = settings
        self.draws_masks = settings.draws_masks
        self._words = words_of(settings.command, PLACES, WHERE)
        self.is_open = "names" in places_in(self._words)
        self.name = f"{settings.kind}:{settings.model}" if settings.model else settings.kind

    def detect(self, pictures: Sequence[Image], names: Sequence[str]) -> list[Detections]:
        """What is in pictures, shapes (h, w, 3), of those names.

        Raises:
            InputError: the program fails, takes too long, or writes what is no answer.
        """
        return [self._found(picture, names) for picture in pictures]

    def _found(self, picture: Image, names: Sequence[str]) -> Detections:
        with temporary_folder() as folder:
            (folder / "image.png").write_bytes(png_of(picture))
            values = {"image": str(folder / "image.png"), "names": ", ".join(names), "out": str(folder / ANSWER)}
            try:
                run_command(filled(self._words, values), folder, self.settings.timeout_seconds)
            except CommandFailed as error:
                raise InputError(WHERE, self._words[0], str(error), "run it by hand to see more") from error
            data = read_file(folder / ANSWER, ANSWER, BUDGET.json_bytes, remedy=f"let {self._words[0]} write {{out}}")
        height, width = picture.shape[:2]
        answer = answer_of(data, height, width)
        if not self.draws_masks:
            answer = dataclasses.replace(answer, masks=None)
        elif answer.masks is None:
            raise _refused("masks", "are not there, and `draws_masks` says that they are")
        return selected(answer.at(np.flatnonzero(answer.scores > self.settings.threshold)), self.settings, height, width)


def answer_of(data: bytes, height: int, width: int) -> Detections:
    """What a program says of a picture of that size [px].

    Raises:
        InputError: it is no JSON, has other fields, lists of different lengths, or values that cannot be.
    """
    try:
        table: Any = json_value(data)
    except ValueError as error:
        raise _refused("content", f"is no JSON ({error})") from error
    if not isinstance(table, dict):
        raise _refused("content", "is no table with boxes, labels and scores")
    boxes, labels, scores = (table.get(field) for field in ("boxes", "labels", "scores"))
    for field, value in (("boxes", boxes), ("labels", labels), ("scores", scores)):
        if not isinstance(value, list) or len(value) > MOST_FOUND:
            raise _refused(field, f"must be a list of up to {MOST_FOUND}")
    assert isinstance(boxes, list)
    assert isinstance(labels, list)
    assert isinstance(scores, list)
    masks = table.get("masks")
    if masks is not None and not isinstance(masks, list):
        raise _refused("masks", "must be a list, or null")
    lengths = {len(boxes), len(labels), len(scores)} | ({len(masks)} if masks is not None else set())
    if len(lengths) > 1:
        raise _refused("boxes", "must be as many as labels, scores and masks")
    if not all(isinstance(label, str) and 0 < len(label.strip()) <= MOST_LETTERS for label in labels):
        raise _refused("labels", f"must be texts of up to {MOST_LETTERS} letters")
    values = _numbers(boxes, "boxes", (len(boxes), 4), max(height, width) * 10.0)
    if (values[:, :2] > values[:, 2:]).any():
        raise _refused("boxes", "must be x0, y0, x1, y1 with x0 <= x1 and y0 <= y1")
    sure = _numbers(scores, "scores", (len(scores),), 1.0)
    if (sure < 0).any():
        raise _refused("scores", "must be 0 to 1")
    drawn = None if masks is None else np.array([_mask(mask, i, height, width) for i, mask in enumerate(masks)]).reshape(-1, height, width)
    return Detections(values, tuple(" ".join(one_line(label).split()) for label in labels), sure, drawn)


def _numbers(value: list[Any], field: str, shape: tuple[int, ...], most: float) -> Array:
    """A list of numbers, or of lists of four, none beyond `most` either way."""
    rows = value if len(shape) == 2 else [value]
    plain = all(isinstance(row, list) and all(isinstance(v, int | float) and not isinstance(v, bool) for v in row) for row in rows)
    if not plain or (len(shape) == 2 and any(len(row) != shape[1] for row in rows)):
        raise _refused(field, "must be four numbers for each" if len(shape) == 2 else "must be numbers")
    if not all(abs(v) <= most for row in rows for v in row):
        raise _refused(field, f"must be finite, and {most:g} at most")
    return np.array(value, dtype=np.float64).reshape(shape)


def _mask(value: Any, number: int, height: int, width: int) -> Bools:
    """A mask out of its run lengths, shape (height, width)."""
    field = f"masks, {number + 1}"
    size, counts = (value.get(name) for name in ("size", "counts")) if isinstance(value, dict) else (None, None)
    if size != [height, width]:
        raise _refused(field, f"size must be [{height}, {width}], as the picture's")
    if isinstance(counts, str):
        raise _refused(field, "counts are packed into a text; write them as a list of run lengths")
    if not isinstance(counts, list) or not all(type(run) is int and 0 <= run <= height * width for run in counts):
        raise _refused(field, "counts must be a list of run lengths")
    if sum(counts) != height * width:
        raise _refused(field, f"counts must sum up to {height * width}, are {sum(counts)}")
    inside = np.repeat(np.arange(len(counts)) % 2 == 1, counts)
    return np.asarray(inside.reshape(width, height).T)


def _refused(field: str, problem: str) -> InputError:
    return InputError(ANSWER, field, problem, 'write {"boxes": [[x0, y0, x1, y1]], "labels": ["mug"], "scores": [0.9]}')
