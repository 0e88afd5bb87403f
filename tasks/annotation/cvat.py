"""CVAT: a batch's objects as images with a label whose attributes are the answer, and answers from exports as "CVAT for images 1.1".

An image is named after batch, scene and instance, so that they come back whatever a task is called.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from datetime import datetime
from pathlib import PurePosixPath
from typing import Any
from xml.etree import ElementTree

from schemas.annotation import BATCH_PATTERN
from schemas.errors import InputError
from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN
from tasks.annotation.batch import moment
from tasks.annotation.exported import LONGEST_NAME, NONE, SLOTS, Accounts, ExportedAnswer, ExportedBatch, exported_batch, ranking_of
from tasks.unpacking import plain_xml_root

LABELS_FILE = "cvat/labels.json"

LABEL, CHOICE, NEXT = "answer", "choice", ("second", "third", "fourth", "fifth")
"""The label, and its attributes: the choice, and what comes after it."""

UNANSWERED = "__undefined__"
"""CVAT shows it as an empty field: an attribute that nobody touched must not pass for an answer."""

VERSION = "1.1"

_BETWEEN = "~"  # in no name of a batch, a scene or an instance


def images_file(place: int) -> str:
    """The list of an annotator's images, by their place among the batch's."""
    return f"cvat/{place:03d}.txt"


def image_name(batch_id: str, scene_id: str, instance_id: str) -> str:
    """The file of an object's picture."""
    return f"{_BETWEEN.join((batch_id, *scene_id.split('/'), instance_id))}.jpg"


def object_of(name: str) -> tuple[str, str, str] | None:
    """Batch, scene and instance that an image is named after, wherever it lies; None where it is named otherwise."""
    parts = PurePosixPath(name.replace("\\", "/")).stem.split(_BETWEEN)
    if len(parts) != 4:
        return None
    batch_id, scene_id, instance_id = parts[0], "/".join(parts[1:3]), parts[3]
    patterns = ((BATCH_PATTERN, batch_id), (SCENE_PATTERN, scene_id), (INSTANCE_PATTERN, instance_id))
    if len(batch_id) > LONGEST_NAME or not all(re.fullmatch(pattern, part, re.ASCII) for pattern, part in patterns):
        return None
    return batch_id, scene_id, instance_id


def labels() -> list[dict[str, Any]]:
    """The labels of a task, as CVAT's raw editor and its command line take them."""
    values = {CHOICE: (*SLOTS, NONE), **dict.fromkeys(NEXT, SLOTS)}
    attributes = [
        {"name": name, "mutable": False, "input_type": "select", "default_value": UNANSWERED, "values": [UNANSWERED, *allowed]}
        for name, allowed in values.items()
    ]
    return [{"name": LABEL, "type": "tag", "attributes": attributes}]


@dataclasses.dataclass(frozen=True)
class AnsweredTask:
    """Who a task or job is assigned to, and when its answers were last changed."""

    accounts: tuple[str, ...]
    updated_at: datetime
    account_field: str
    time_field: str


def read_cvat(data: bytes, name: str, accounts: Accounts) -> ExportedBatch:
    """The answers in the XML of a job, a task or a project; `name` is what errors call it.

    Whose they are says the assignee, and when they were given, for all of a job alike, the time of its last change. Images without
    a choice, other labels and shapes are left out.

    Raises:
        InputError: the file is no such export, an answer contradicts itself, or as `exported_batch`. Names the element.
    """
    root = _root(data, name)
    tasks = _answered_tasks(root, name)
    answers: list[ExportedAnswer] = []
    left_out: list[str] = []
    for index, image in enumerate(root.iterfind("image")):
        where = f"image[{index}]"
        own: list[tuple[str, ElementTree.Element]] = []
        for number, element in enumerate(image):
            place = f"{where}.{element.tag}[{number}]"
            if element.tag == "tag" and element.get("label") == LABEL:
                own.append((place, element))
            else:
                left_out.append(f"{place}: of the label {element.get('label')!r:.60}, which no answer has")
        if len(own) > 1:
            raise InputError(name, own[1][0], f"is another {LABEL!r} of one image", "leave one of them")
        for place, element in own:
            answer = _answer(image, element, tasks, name, where, place, left_out)
            if answer is not None:
                answers.append(answer)
    return exported_batch(answers, left_out, name, accounts, "CVAT", is_dated=False)


def _root(data: bytes, name: str) -> ElementTree.Element:
    if data.startswith(b"PK\x03\x04"):
        raise InputError(name, "document", "is a ZIP archive", "unpack it, and name the annotations.xml in it")
    remedy = "export the job, task or project as 'CVAT for images 1.1'"
    try:
        root = plain_xml_root(data)
    except ElementTree.ParseError as error:
        line, column = error.position
        raise InputError(name, f"line {line} column {column + 1}", "is no XML", remedy) from error
    except (LookupError, ValueError) as error:
        raise InputError(name, "document", f"is no XML that is read ({error})", remedy) from error
    if root.tag != "annotations":
        raise InputError(name, "annotations", f"is not what it begins with, which is {root.tag!r:.40}", remedy)
    version = (root.findtext("version") or "").strip()
    if version != VERSION:
        raise InputError(name, "version", f"is {version!r:.40}, and {VERSION} is read", remedy)
    if root.find("track") is not None:
        raise InputError(name, "track", "is of an export of videos", remedy)
    return root


def _answered_tasks(root: ElementTree.Element, name: str) -> dict[str | None, AnsweredTask]:
    """What was exported, by the id that images name: that of a task of a project; of a job or a task alone, under None."""
    for kind in ("job", "task"):
        element = root.find(f"meta/{kind}")
        if element is not None:
            return {None: _answered_task(root, element, name, f"meta.{kind}")}
    tasks: dict[str | None, AnsweredTask] = {}
    for index, element in enumerate(root.iterfind("meta/project/tasks/task")):
        place = f"meta.project.tasks.task[{index}]"
        number = (element.findtext("id") or "").strip()
        if not number or number in tasks:
            raise InputError(name, f"{place}.id", "is there twice" if number else "is missing", "export the project again")
        tasks[number] = _answered_task(root, element, name, place)
    if not tasks:
        raise InputError(name, "meta", "has no job, no task and no tasks of a project", "export as 'CVAT for images 1.1'")
    return tasks


def _answered_task(root: ElementTree.Element, element: ElementTree.Element, name: str, place: str) -> AnsweredTask:
    accounts = []
    for field in ("username", "email"):
        word = (element.findtext(f"assignee/{field}") or "").strip()
        if len(word) > LONGEST_NAME or not word.isprintable():
            raise InputError(name, f"{place}.assignee.{field}", f"is no name of up to {LONGEST_NAME} letters", "correct it")
        accounts += [word] if word else []
    field = f"{place}.updated" if element.find("updated") is not None else "meta.dumped"
    text = element.findtext("updated") or root.findtext("meta/dumped") or ""
    return AnsweredTask(tuple(accounts), moment(text.strip(), name, field), f"{place}.assignee", field)


def _answer(
    image: ElementTree.Element, tag: ElementTree.Element, tasks: dict[str | None, AnsweredTask], name: str, where: str, place: str,
    left_out: list[str],
) -> ExportedAnswer | None:  # fmt: skip
    """The answer in the tag of an image; None where it has no choice."""
    called = object_of(image.get("name") or "")
    if called is None:
        problem = f"{image.get('name')!r:.80} names no object of a batch"
        raise InputError(name, f"{where}.name", problem, "make the task of the images in the batch's folder, as they are called")
    number = None if None in tasks else image.get("task_id")
    if number not in tasks:
        raise InputError(name, f"{where}.task_id", f"{number!r:.40} is no task of the project", "export the project again")
    task = tasks[number]
    slots = _attributes(tag, name, place, left_out)
    if CHOICE not in slots:
        left_out.append(f"{place}: has no choice")
        return None
    choice = slots[CHOICE]
    after = [slot for key in NEXT if (slot := slots.get(key)) is not None]
    batch_id, scene_id, instance_id = called
    return ExportedAnswer(
        batch_id, scene_id, instance_id, task.accounts, task.updated_at, choice, ranking_of(choice, after, name, place), None, place,
        object_field=f"{where}.name", account_field=task.account_field, time_field=task.time_field,
    )  # fmt: skip


def _attributes(tag: ElementTree.Element, name: str, place: str, left_out: list[str]) -> dict[str, int | None]:
    """Slots by attribute; None as the choice where no candidate fits. What nobody touched is not among them."""
    slots: dict[str, int | None] = {}
    named: set[str] = set()
    for number, attribute in enumerate(tag.iterfind("attribute")):
        key, word, field = attribute.get("name") or "", (attribute.text or "").strip(), f"{place}.attribute[{number}]"
        if key not in (CHOICE, *NEXT):
            left_out.append(f"{field}: {key!r:.60}, which no answer has")
            continue
        if key in named:
            raise InputError(name, field, f"is another {key!r}", "export the task again")
        named.add(key)
        if word in ("", UNANSWERED):
            continue
        allowed: Sequence[str] = (*SLOTS, NONE) if key == CHOICE else SLOTS
        if word not in allowed:
            raise InputError(name, field, f"{word!r:.40} is no candidate", f"allowed for {key} are {', '.join(allowed)}")
        slots[key] = None if word == NONE else int(word)
    return slots
