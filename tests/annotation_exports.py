"""Label Studio and CVAT, simulated: people answer what the folder of a batch hands these tools, and the tools export it.

What an export holds is made from the labeling config, the labels and the tasks that were written, and as the tools document it.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from tests.samples import START

Object = tuple[str, str]
"""Scene and instance."""


@dataclasses.dataclass(frozen=True)
class Given:
    """What somebody gave for an object: a slot or none that fits, what comes next, how many hours after the start, in how many seconds."""

    choice: int | None
    after: tuple[int, ...] = ()
    at: float = 0.0
    seconds: float | None = 12.5

    @property
    def time(self) -> datetime:
        return START + timedelta(hours=self.at)

    def as_answer(self, key: Object, annotator: str) -> dict[str, Any]:
        """The same after `batch.schema.json`."""
        ranking = list(self.after) if self.choice is None or not self.after else [self.choice, *self.after]
        stated = {"scene_id": key[0], "instance_id": key[1], "annotator": annotator, "answered_at": self.time.isoformat()}
        return stated | {"choice": self.choice, "ranking": ranking, "seconds": self.seconds}


def word(slot: int | None) -> str:
    return "none" if slot is None else str(slot)


def asked(folder: Path) -> dict[str, list[Object]]:
    """Whom a batch asks about what, in order."""
    work = json.loads((folder / "work.json").read_text())
    return {row["annotator"]: [(key["scene_id"], key["instance_id"]) for key in row["objects"]] for row in work["annotators"]}


def label_studio_result(config: ElementTree.Element, given: Given) -> list[dict[str, Any]]:
    """Results of the controls of a labeling config."""
    choices, ranker = config.find("Choices"), config.find("Ranker")
    assert choices is not None
    assert ranker is not None
    assert word(given.choice) in {choice.get("value") for choice in choices}
    results: list[dict[str, Any]] = [{"value": {"choices": [word(given.choice)]}, "control": choices, "type": "choices"}]
    if given.after:
        (bucket,) = [bucket.get("name") for bucket in ranker]
        rest = [str(slot) for slot in range(1, 11) if slot not in given.after]
        results.append({"value": {"ranker": {bucket: [str(slot) for slot in given.after], "_": rest}}, "control": ranker, "type": "ranker"})
    return [
        {"id": f"r{index}", "origin": "manual", "type": row["type"], "value": row["value"]}
        | {"from_name": row["control"].get("name"), "to_name": row["control"].get("toName")}
        for index, row in enumerate(results)
    ]


def label_studio_export(
    folder: Path, place: int, answers: Mapping[Object, Sequence[tuple[Any, Given | None]]], tasks: Sequence[Any] | None = None
) -> list[Any]:
    """A project's export: of every task the annotations, each of a user (`completed_by`), None where the task was skipped."""
    config = ElementTree.fromstring((folder / "label-studio/config.xml").read_text())
    exported = []
    for number, task in enumerate(tasks or json.loads((folder / f"label-studio/{place:03d}.json").read_text()), 1):
        annotations = []
        for user, given in answers.get((task["data"]["scene_id"], task["data"]["instance_id"]), ()):
            time = (given or Given(None)).time.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
            annotations.append(
                {
                    "id": 100 * number + len(annotations),
                    "completed_by": user,
                    "result": [] if given is None else label_studio_result(config, given),
                    "was_cancelled": given is None,
                    "ground_truth": False,
                    "created_at": START.strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
                    "updated_at": time,
                    "lead_time": None if given is None else given.seconds,
                    "task": number,
                    "result_count": 0,
                    "parent_prediction": None,
                }
            )
        exported.append(
            {"id": number, "data": task["data"], "annotations": annotations, "drafts": [], "predictions": [], "meta": {}, "project": 7}
        )
    return exported


def user(name: str, number: int = 1) -> dict[str, Any]:
    """Who is logged in to Label Studio."""
    return {"id": number, "email": name, "first_name": "", "last_name": ""}


def cvat_meta(kind: str, assignee: str | None, at: float, number: int = 1) -> ElementTree.Element:
    """What CVAT says of a task or a job."""
    element = ElementTree.Element(kind)
    for name, text in (("id", str(number)), ("mode", "annotation"), ("created", str(START)), ("updated", str(START + timedelta(hours=at)))):
        ElementTree.SubElement(element, name).text = text
    owner, person = ElementTree.SubElement(element, "owner"), ElementTree.SubElement(element, "assignee")
    ElementTree.SubElement(owner, "username").text = "boss"
    if assignee is not None:
        ElementTree.SubElement(person, "username").text = assignee
        ElementTree.SubElement(person, "email").text = f"{assignee}@example.org"
    return element


def cvat_export(
    folder: Path, place: int, answers: Mapping[Object, Given | None], assignee: str | None, at: float = 0.0, kind: str = "job"
) -> ElementTree.Element:
    """The export of a job or a task: every image of an annotator's list; those that are not in `answers` bear no tag, and the attributes
    of a tag that is None were not touched."""
    root = ElementTree.Element("annotations")
    ElementTree.SubElement(root, "version").text = "1.1"
    meta = ElementTree.SubElement(root, "meta")
    meta.append(cvat_meta(kind, assignee, at))
    ElementTree.SubElement(meta, "dumped").text = str(START + timedelta(hours=at + 1))
    (label,) = json.loads((folder / "cvat/labels.json").read_text())
    for index, line in enumerate((folder / f"cvat/{place:03d}.txt").read_text().split()):
        name = line.rpartition("/")[2]
        image = ElementTree.SubElement(root, "image", id=str(index), name=name, width="1098", height="392")
        _, dataset, scan, instance = name.removesuffix(".jpg").split("~")
        key = (f"{dataset}/{scan}", instance)
        if key in answers:
            tag = ElementTree.SubElement(image, "tag", label=label["name"], source="manual")
            given = answers[key]
            words = [] if given is None else [word(given.choice), *map(word, given.after)]
            for number, attribute in enumerate(label["attributes"]):
                value = words[number] if number < len(words) else attribute["default_value"]
                assert value in attribute["values"]
                ElementTree.SubElement(tag, "attribute", name=attribute["name"]).text = value
    return root


def cvat_project(parts: Sequence[ElementTree.Element]) -> ElementTree.Element:
    """The export of a project, from those of its tasks."""
    root = ElementTree.Element("annotations")
    ElementTree.SubElement(root, "version").text = "1.1"
    meta = ElementTree.SubElement(root, "meta")
    tasks = ElementTree.SubElement(ElementTree.SubElement(meta, "project"), "tasks")
    for number, part in enumerate(parts, 1):
        (task,) = part.findall("meta/task")
        task.find("id").text = str(number)  # type: ignore[union-attr]
        tasks.append(task)
        for image in part.iterfind("image"):
            image.set("task_id", str(number))
            image.set("subset", "default")
            root.append(image)
    return root


def xml(root: ElementTree.Element) -> bytes:
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
