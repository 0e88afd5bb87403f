"""Answers given in Label Studio and CVAT, from the folder of a batch into the lake: the same rows as by files after batch.schema.json."""

from __future__ import annotations

import copy
import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from PIL import Image

from flows.cli import cli
from flows.inputs.annotation import batch_list, import_export, save_answers, submit
from schemas.annotation import Annotation
from schemas.errors import InputError
from tasks.annotation.cvat import object_of
from tests.annotated import SCENES, annotatable, created
from tests.annotation_exports import Given, Object, asked, cvat_export, cvat_project, label_studio_export, user, xml
from warehouse.lake import Lake


@pytest.fixture
def lake(tmp_path: Path) -> Lake:
    return annotatable(tmp_path / "lake")


@pytest.fixture
def folder(lake: Lake, tmp_path: Path) -> Path:
    created(lake, tmp_path / "work", overlap=2)
    return tmp_path / "work"


def rows(lake: Lake) -> list[Annotation]:
    """What the answers of a lake say, wherever they were read from."""
    stripped = [dataclasses.replace(row, source_file="", tool=None) for row in lake.snapshot().rows(Annotation)]
    return sorted(stripped, key=lambda row: (row.scene_id, row.instance_id, row.annotator, row.revision))


def by_files(lake: Lake, tmp_path: Path, *batches: dict[str, Any]) -> list[Annotation]:
    """The same answers in another lake, after batch.schema.json."""
    other = annotatable(tmp_path / "other")
    created(other, tmp_path / "other_work", overlap=2)
    for batch in batches:
        save_answers(other, {"batch_id": "b1", "annotations": list(batch["annotations"])})
    return rows(other)


def given_by(keys: list[Object], first: int) -> dict[Object, Given]:
    """Answers of all kinds, another for every object and person."""
    kinds = [Given(1), Given(2, (1, 3)), Given(None), Given(3, (2,), 0.5), Given(None, (2, 1), 0.25), Given(2, (3, 1))]
    return {key: kinds[(first + index) % len(kinds)] for index, key in enumerate(keys)}


def saved(path: Path, value: Any) -> Path:
    path.write_bytes(value if isinstance(value, bytes) else json.dumps(value).encode())
    return path


def test_the_folder_has_what_the_tools_import(folder: Path) -> None:
    for place, (name, keys) in enumerate(asked(folder).items(), 1):
        tasks = json.loads((folder / f"label-studio/{place:03d}.json").read_text())
        assert [(task["data"]["scene_id"], task["data"]["instance_id"]) for task in tasks] == keys, name
        for task in tasks:
            data = task["data"]
            addresses = [data["sheet"], *(item["html"].partition('src="')[2].partition('"')[0] for item in data["candidates"])]
            files = [folder / address.removeprefix("/data/local-files/?d=") for address in addresses]
            assert all(file.read_bytes()[:2] == b"\xff\xd8" for file in files)
            assert [item["id"] for item in data["candidates"]] == ["1", "2", "3"]
            assert (data["batch_id"], data["photo"]) == ("b1", None)
        images = (folder / f"cvat/{place:03d}.txt").read_text().split()
        assert [object_of(image) for image in images] == [("b1", *key) for key in keys]
        with Image.open(io.BytesIO((folder / images[0]).read_bytes())) as sheet:
            assert sheet.width > sheet.height > 300


def test_label_studio_gives_the_answers_back_that_files_would(lake: Lake, folder: Path, tmp_path: Path) -> None:
    """Everybody's tasks in one project: answers of all, one edited after the first export, one skipped."""
    people = {name: given_by(keys, place) for place, (name, keys) in enumerate(asked(folder).items())}
    skipped = next(reversed(people["cleo"]))
    answers: dict[Object, list[tuple[Any, Given | None]]] = {}
    for number, (name, given) in enumerate(people.items(), 1):
        for key, value in given.items():
            answers.setdefault(key, []).append((user(name, number), None if (name, key) == ("cleo", skipped) else value))
    del people["cleo"][skipped]
    tasks = list({json.dumps(task): task for place in (1, 2, 3) for task in read(folder, place)}.values())
    first = import_export(lake, saved(tmp_path / "a.json", label_studio_export(folder, 1, answers, tasks)), "label-studio")
    assert (first["new"], len(first["left_out"]), "was skipped" in first["left_out"][0]) == (15, 1, True)
    edited = next(iter(people["bob"]))
    later = [(who, Given(3, (1,), 9.0) if who["email"] == "bob" else given) for who, given in answers[edited]]
    again = saved(tmp_path / "b.json", label_studio_export(folder, 1, answers | {edited: later}, tasks))
    second = import_export(lake, again, "label-studio")
    assert (second["new"], second["corrected"], import_export(lake, again, "label-studio")["already"]) == (0, 1, True)
    assert import_export(lake, tmp_path / "a.json", "label-studio")["already"], "an older export changes nothing"
    whole = {"annotations": [given.as_answer(key, name) for name, own in people.items() for key, given in own.items()]}
    correction = {"annotations": [Given(3, (1,), 9.0).as_answer(edited, "bob")]}
    assert rows(lake) == by_files(lake, tmp_path, whole, correction)
    assert {row.tool for row in lake.snapshot().rows(Annotation)} == {"Label Studio"}


def read(folder: Path, place: int) -> list[Any]:
    return list(json.loads((folder / f"label-studio/{place:03d}.json").read_text()))


@pytest.mark.parametrize("is_project", [False, True])
def test_cvat_gives_the_answers_back_that_files_would(lake: Lake, folder: Path, tmp_path: Path, is_project: bool) -> None:
    """A job for each person, or a project of tasks: all answers of one have the time when it was last changed."""
    people = {name: given_by(keys, place) for place, (name, keys) in enumerate(asked(folder).items())}
    untouched = next(reversed(people["ada"]))
    kind = "task" if is_project else "job"
    exports = [
        cvat_export(folder, place, own | ({untouched: None} if name == "ada" else {}), name, 4.0, kind)  # type: ignore[arg-type]
        for place, (name, own) in enumerate(people.items(), 1)
    ]
    del people["ada"][untouched]
    files = [xml(cvat_project(copy.deepcopy(exports)))] if is_project else [xml(export) for export in exports]
    done = [import_export(lake, saved(tmp_path / f"{number}.xml", data), "cvat") for number, data in enumerate(files)]
    assert (sum(row["new"] for row in done), [line for row in done for line in row["left_out"]]) == (
        15,
        [f"image[{list(asked(folder)['ada']).index(untouched)}].tag[0]: has no choice"],
    )
    changed = next(iter(people["bob"]))
    bob = cvat_export(folder, 2, people["bob"] | {changed: Given(3, (2, 1))}, "bob", 8.0)
    again = import_export(lake, saved(tmp_path / "bob.xml", xml(bob)), "cvat")
    assert (again["new"], again["corrected"]) == (0, 1), "what was not changed is not given anew"
    assert all(import_export(lake, path, "cvat")["already"] for path in sorted(tmp_path.glob("*.xml"))), "older exports change nothing"
    whole = [
        dataclasses.replace(given, at=4.0, seconds=None).as_answer(key, name) for name, own in people.items() for key, given in own.items()
    ]
    correction = {"annotations": [Given(3, (2, 1), 8.0, None).as_answer(changed, "bob")]}
    assert rows(lake) == by_files(lake, tmp_path, {"annotations": whole}, correction)


def test_who_is_who_is_said_where_a_tool_does_not_know(lake: Lake, folder: Path, tmp_path: Path) -> None:
    (ada, *_), (bob, *_) = asked(folder)["ada"], asked(folder)["bob"]
    numbers = saved(tmp_path / "n.json", label_studio_export(folder, 1, {ada: [(3, Given(1))]}))
    before = lake.snapshot().snapshot_id
    with pytest.raises(InputError, match=r"completed_by: says no more of who answered than '3'; give --annotator 3=NAME"):
        import_export(lake, numbers, "label-studio")
    with pytest.raises(InputError, match=r"--annotator: 4: gave no answer in n\.json"):
        import_export(lake, numbers, "label-studio", ["3=ada", "4=bob"])
    with pytest.raises(InputError, match=r"\.annotator: nothing was assigned to eve in batch b1"):
        import_export(lake, numbers, "label-studio", ["eve"])
    assert import_export(lake, numbers, "label-studio", ["ada"], dry_run=True)["new"] == 1
    assert lake.snapshot().snapshot_id == before, "nothing by half"
    assert import_export(lake, numbers, "label-studio", ["3=ada"])["new"] == 1
    job = saved(tmp_path / "job.xml", xml(cvat_export(folder, 2, {bob: Given(2)}, None)))
    with pytest.raises(InputError, match=r"meta\.job\.assignee: does not say who answered; give --annotator NAME"):
        import_export(lake, job, "cvat")
    assert import_export(lake, job, "cvat", ["bob"])["new"] == 1
    named = saved(tmp_path / "named.xml", xml(cvat_export(folder, 2, {bob: Given(3)}, "rob", 2.0)))
    with pytest.raises(InputError, match=r"--annotator: bob: is not needed: named\.xml says who answered"):
        import_export(lake, named, "cvat", ["bob"])
    for account in ("rob", "rob@example.org"):
        assert import_export(lake, named, "cvat", [f"{account}=bob"], dry_run=True)["corrected"] == 1


def test_exports_pass_the_same_gate_as_files(lake: Lake, folder: Path, tmp_path: Path) -> None:
    people = asked(folder)
    for place, (name, keys) in enumerate(people.items(), 1):
        export = label_studio_export(folder, place, {key: [(user(name), Given(1))] for key in keys})
        import_export(lake, saved(tmp_path / f"{name}.json", export), "label-studio")
    key = people["ada"][0]
    foreign = label_studio_export(folder, 1, {key: [(user("ada"), Given(7, (), 5.0))]})
    with pytest.raises(InputError, match=r"\.annotations\[0\]\.choice: slot 7 of instance .* is not filled"):
        import_export(lake, saved(tmp_path / "slot.json", foreign), "label-studio")
    earlier = label_studio_export(folder, 1, {key: [(user("ada"), Given(2, (), 0.0))]})
    with pytest.raises(InputError, match=r"\.answered_at: is not later"):
        import_export(lake, saved(tmp_path / "earlier.json", earlier), "label-studio")
    submit(lake, "b1", "ada")
    late = xml(cvat_export(folder, 1, {key: Given(2)}, "ada", 6.0))
    with pytest.raises(InputError, match="b1 is submitted: one cannot answer now"):
        import_export(lake, saved(tmp_path / "late.xml", late), "cvat")
    assert len(lake.snapshot().rows(Annotation)) == 16


def test_the_command_imports_exports_and_names_what_it_leaves_out(lake: Lake, folder: Path, tmp_path: Path) -> None:
    (first, second, *_) = asked(folder)["ada"]
    export = label_studio_export(folder, 1, {first: [(7, Given(2, (1,)))], second: [(7, None)]})
    (position,) = [index for index, task in enumerate(export) if task["annotations"] and task["annotations"][0]["was_cancelled"]]
    answered = next(task["annotations"][0] for task in export if task["annotations"] and not task["annotations"][0]["was_cancelled"])
    answered["result"].append({"from_name": "mood\x1b[2J", "to_name": "sheet", "type": "rating", "value": {"rating": 3}})
    words = ["annotate", "import", str(saved(tmp_path / "e.json", export)), "--format", "label-studio", "--lake", lake.address]
    done = CliRunner().invoke(cli, [*words, "--annotator", "7=ada"])
    assert done.exit_code == 0, done.output
    assert "batch b1: 1 answer of 1 annotator on 1 scene imported (1 new)" in done.output
    assert f"note: left out [{position}].annotations[0]: was skipped" in done.stderr
    assert "result[2]: of the control 'mood" in done.stderr
    assert "\x1b" not in done.stderr
    (listed,) = batch_list(lake, "b1")
    assert listed["by_annotator"]["ada"]["answered"] == 1
    wrong = CliRunner().invoke(cli, [*words[:3], "--annotator", "ada", "--lake", lake.address])
    assert (wrong.exit_code, "--annotator is for --format label-studio and cvat" in wrong.output) == (2, True)


def test_a_batch_of_others_may_come_from_a_tool(lake: Lake, tmp_path: Path) -> None:
    data = {"batch_id": "else-1", "scene_id": SCENES[0], "instance_id": "0001"}
    result = [{"from_name": "choice", "type": "choices", "value": {"choices": ["2"]}}]
    annotation = {"completed_by": user("eve@example.org"), "result": result, "updated_at": "2026-03-01T14:05:00.000000Z"}
    done = import_export(lake, saved(tmp_path / "e.json", [{"data": data, "annotations": [annotation]}]), "label-studio")
    assert (done["new"], done["state"], done["counts"]) == (1, "submitted", False)
