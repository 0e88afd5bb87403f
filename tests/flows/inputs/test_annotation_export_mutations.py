"""Hundreds of exports of Label Studio and CVAT that are nearly right: taken as they stand, or refused by a field; none by half."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any
from xml.etree import ElementTree

import pytest

from flows.inputs.annotation import BatchPlan, create_batch, import_export
from flows.inputs.annotation.importing import EXPORTS, held_against
from flows.run.configuration import configure
from schemas.annotation import Annotation
from schemas.candidates import Candidate
from schemas.errors import InputError
from schemas.record import check
from tasks.annotation.cvat import object_of
from tasks.annotation.exported import accounts_of
from tests.annotated import annotatable
from tests.annotation_exports import Given, asked, cvat_export, cvat_project, label_studio_export, user, xml
from tests.flows.inputs.test_annotation_mutations import OF_THE_WHOLE, Cached
from tests.fuzzing.mutations import changed_file
from warehouse.lake import Lake

FILES = 500

WORDS = [
    "ada", "bob", "eve", "", "b1", "b2", "demo/room_a", "demo/none", "0001", "0009", "9999", "1", "2", "3", "4", "11", "none", "choice",
    "ranking", "next", "answer", "__undefined__", "2026-03-01T14:05:00Z", "2026-03-01", "b1~demo~room_a~0002.jpg", "7",
]  # fmt: skip
"""Values of the right kind, many of them another answer's."""


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    folder = tmp_path_factory.mktemp("exports")
    lake = annotatable(folder / "lake", objects=2)
    create_batch(lake, BatchPlan("b1", ("ada", "bob"), 2), folder / "work")
    first = label_studio_export(folder / "work", 1, {asked(folder / "work")["ada"][0]: [(user("ada"), Given(3))]})
    (folder / "first.json").write_text(json.dumps(first))
    import_export(lake, folder / "first.json", "label-studio")
    return lake


def sound(lake: Lake) -> dict[str, bytes]:
    """An export of either tool, with answers of every kind by two people."""
    folder = Path(lake.address).parent / "work"
    kinds = [Given(1, (3, 2), 5.0), Given(None, (), 6.0), Given(2, (2, 1), 7.0, None), Given(3, (), 5.0)]
    keys = asked(folder)
    people = {name: dict(zip(own, kinds[place:] + kinds[:place], strict=False)) for place, (name, own) in enumerate(keys.items())}
    answers: dict[Any, list[Any]] = {}
    for name, own in people.items():
        for key, given in own.items():
            answers.setdefault(key, []).append((user(name), given))
    answers[keys["ada"][3]][0] = (user("ada"), None)
    tasks = [
        cvat_export(folder, place, {key: kinds[index] for index, key in enumerate(own)}, name, 8.0, "task")
        for place, (name, own) in enumerate(keys.items(), 1)
    ]
    return {"label-studio": json.dumps(label_studio_export(folder, 1, answers)).encode(), "cvat": xml(cvat_project(tasks))}


def nodes(value: Any) -> Iterator[Any]:
    """Lists and objects of a JSON value that are not empty."""
    if value and isinstance(value, dict | list):
        yield value
        for inner in value.values() if isinstance(value, dict) else value:
            yield from nodes(inner)


def otherwise(tool: str, data: bytes, random: Random) -> bytes:
    """An export with one value that is another's, or with one value, list or element less or twice."""
    if tool == "label-studio":
        document = json.loads(data)
        node = random.choice(list(nodes(document)))
        key = random.choice(list(node)) if isinstance(node, dict) else random.randrange(len(node))
        match random.randrange(4):
            case 0:
                del node[key]
            case 1 if isinstance(node, list):
                node.append(node[key])
            case _:
                node[key] = random.choice([*WORDS, 3, 0.5, None, True, [], {}])
        return json.dumps(document).encode()
    root = ElementTree.fromstring(data)
    element = random.choice(list(root.iter()))
    match random.randrange(4):
        case 0 if len(element):
            element.remove(random.choice(list(element)))
        case 1 if len(element):
            element.append(random.choice(list(element)))
        case 2 if element.attrib:
            element.set(random.choice(list(element.attrib)), random.choice(WORDS))
        case _:
            element.text = random.choice(WORDS)
    return xml(root)


def mutated(tool: str, data: bytes, number: int) -> bytes:
    """A sound export with one to three changes: of a value, of the structure, of the bytes."""
    random = Random(number)
    for _ in range(random.choice([1, 1, 2, 3])):
        try:
            data = otherwise(tool, data, random) if random.random() < 0.6 else changed_file(f"e.{ENDINGS[tool]}", data, random)
        except (ValueError, ElementTree.ParseError, RecursionError, LookupError):
            data = changed_file(f"e.{ENDINGS[tool]}", data, random)
    return data


ENDINGS = {"label-studio": "json", "cvat": "xml"}


def label_studio_answers(data: bytes) -> Counter[tuple[Any, ...]]:
    """What a JSON export says, read as plainly as may be: scene, instance, annotator, choice and what comes next."""
    said: Counter[tuple[Any, ...]] = Counter()
    for task in json.loads(data.decode("utf-8-sig")):
        for annotation in task["annotations"]:
            given = {result.get("from_name"): result.get("value") for result in annotation["result"]}
            if not annotation.get("was_cancelled") and "choice" in given:
                who = annotation["completed_by"]
                name = next((word.strip() for word in (who.get("email"), who.get("username")) if word and word.strip()), "")
                after = ((given.get("ranking") or {}).get("ranker") or {}).get("next", [])
                place = (task["data"]["scene_id"], task["data"]["instance_id"])
                said[(*place, name, given["choice"]["choices"][0], tuple(after))] += 1
    return said


def cvat_answers(data: bytes) -> Counter[tuple[Any, ...]]:
    """The same of an XML export."""
    said: Counter[tuple[Any, ...]] = Counter()
    root = ElementTree.fromstring(data)
    assignees = {(task.findtext("id") or "").strip(): task for task in root.iterfind("meta/project/tasks/task")}
    for image in root.iterfind("image"):
        for tag in image.iterfind("tag[@label='answer']"):
            words = {attribute.get("name"): (attribute.text or "").strip() for attribute in tag.iterfind("attribute")}
            after = [
                words[key] for key in ("second", "third", "fourth", "fifth") if words.get(key, "__undefined__") not in ("__undefined__", "")
            ]
            if words.get("choice", "__undefined__") not in ("__undefined__", ""):
                task = assignees[image.get("task_id") or ""]
                name = (task.findtext("assignee/username") or "").strip() or (task.findtext("assignee/email") or "").strip()
                called = object_of(image.get("name") or "")
                assert called is not None
                said[(*called[1:], name, words["choice"], tuple(after))] += 1
    return said


NAMED = {
    "label-studio": {"choices", "next", "result", "data", "completed_by", "updated_at", "annotator", "choice"},
    "cvat": {"attribute", "tag", "updated", "task_id", "name", "id", "annotator", "version", "meta"},
}
"""Fields that some of the refusals name."""

READ = {"label-studio": label_studio_answers, "cvat": cvat_answers}


@pytest.mark.whole
@pytest.mark.parametrize("tool", sorted(EXPORTS))
def test_exports_are_taken_as_they_stand_or_refused_with_a_field(lake: Lake, tmp_path: Path, tool: str) -> None:
    cached, configuration, whole = Cached(lake), configure(), sound(lake)[tool]
    slots = {row.asset_id: str(row.slot) for row in lake.snapshot().rows(Candidate) if row.instance_id == "0001"}
    before, answers = lake.snapshot().snapshot_id, len(lake.snapshot().rows(Annotation))
    fields: Counter[str] = Counter()
    taken = 0
    file = tmp_path / f"export.{ENDINGS[tool]}"
    for number in range(FILES):
        data = mutated(tool, whole, number)
        file.write_bytes(data)
        refused: InputError | None = None
        try:
            exported = EXPORTS[tool](data, file.name, accounts_of([]))
            held = held_against(cached, exported.batch, file.name, configuration)  # type: ignore[arg-type]
        except InputError as error:
            refused = error
        if refused is not None:
            assert "\n" not in str(refused), number
            assert refused.file == file.name, number
            assert refused.field or refused.problem.startswith(OF_THE_WHOLE), (number, str(refused))
            fields[refused.field.rpartition(".")[2].partition("[")[0]] += 1
            if number % 50 == 0:
                with pytest.raises(InputError):
                    import_export(lake, file, tool)
            continue
        taken += 1
        check(held.given, Annotation)
        said = READ[tool](data)
        for row in held.given:
            choice = "none" if row.choice is None else slots[row.choice]
            after = [slots[asset] for asset in row.ranking]
            rankings = {tuple(after), tuple(after[1:])} if row.choice is not None else {tuple(after)}
            keys = [(row.scene_id, row.instance_id, row.annotator, choice, ranking) for ranking in rankings]
            assert any(said[key] for key in keys), (number, row, said)
        objects = {key[:3] for key in said}
        assert {(row.scene_id, row.instance_id, row.annotator) for row in held.given} == objects, "all of it"
        if number % 25 == 0:
            copy = Lake.open(shutil.copytree(lake.address, tmp_path / f"copy{number}"))
            summary = import_export(copy, file, tool)
            assert len(copy.snapshot().rows(Annotation)) == answers + len(held.new)
            assert summary["left_out"] == list(exported.left_out)
    assert lake.snapshot().snapshot_id == before
    assert taken > FILES // 10
    assert NAMED[tool] <= set(fields), fields
