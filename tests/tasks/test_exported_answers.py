"""Answers in exports of Label Studio and CVAT: read as they were given, left out by name, or refused by field."""

from __future__ import annotations

import json
from datetime import timedelta
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.annotation import cvat, label_studio
from tasks.annotation.batch import AnnotatorAnswer
from tasks.annotation.exported import Accounts, accounts_of
from tests.annotation_exports import Given, Object, cvat_export, label_studio_export, user, xml
from tests.samples import START

KEYS: list[Object] = [(f"demo/room_{letter}", f"{number:04d}") for letter in "ab" for number in (1, 2)]
NOBODY = Accounts({})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the folder of a batch has for the tools, for one annotator and objects with ten candidates."""
    folder = tmp_path_factory.mktemp("work")
    (folder / "label-studio").mkdir()
    (folder / "cvat").mkdir()
    candidates = [{"slot": slot, "thumbnail": f"thumbnails/{slot}.jpg"} for slot in range(1, 11)]
    objects = [
        {"scene_id": scene, "instance_id": name, "category": "chair", "caption": None, "view": None, "candidates": candidates}
        for scene, name in KEYS
    ]
    sheets = {key: f"sheets/{cvat.image_name('b1', *key)}" for key in KEYS}
    (folder / label_studio.CONFIG_FILE).write_text(label_studio.labeling_config())
    (folder / label_studio.tasks_file(1)).write_text(json.dumps(label_studio.tasks_of("b1", objects, sheets)))
    (folder / cvat.LABELS_FILE).write_text(json.dumps(cvat.labels()))
    (folder / cvat.images_file(1)).write_text("\n".join(sheets.values()))
    return folder


def label_studio_bytes(folder: Path, answers: dict[Object, list[tuple[Any, Given | None]]]) -> bytes:
    return json.dumps(label_studio_export(folder, 1, answers)).encode()


def of(rows: tuple[AnnotatorAnswer, ...]) -> dict[tuple[str, str, str], AnnotatorAnswer]:
    return {(row.scene_id, row.instance_id, row.annotator): row for row in rows}


@st.composite
def answers(draw: st.DrawFn) -> Given:
    order = draw(st.permutations(range(1, 11)))
    choice = draw(st.sampled_from([None, order[0]]))
    return Given(
        choice, tuple(order[1 : 1 + draw(st.integers(0, 4))]), draw(st.integers(0, 999)) / 3600, draw(st.none() | st.floats(0, 1e5))
    )


@given(
    by_person=st.dictionaries(
        st.sampled_from(["ada@a.org", "bob@b.org", "é"]), st.dictionaries(st.sampled_from(KEYS), answers()), min_size=1
    )
)
def test_label_studio_says_what_people_gave(folder: Path, by_person: dict[str, dict[Object, Given]]) -> None:
    answered: dict[Object, list[tuple[Any, Given | None]]] = {}
    for name, own in by_person.items():
        for key, value in own.items():
            answered.setdefault(key, []).append((user(name), value))
    if not answered:
        with pytest.raises(InputError, match="answers: none can be taken"):
            label_studio.read_label_studio(label_studio_bytes(folder, answered), "e.json", NOBODY)
        return
    exported = label_studio.read_label_studio(label_studio_bytes(folder, answered), "e.json", NOBODY)
    rows = of(exported.batch.annotations)
    assert rows.keys() == {(*key, name) for name, own in by_person.items() for key in own}
    for name, own in by_person.items():
        for key, value in own.items():
            row = rows[(*key, name)]
            expected = value.as_answer(key, name)
            assert (row.choice, list(row.ranking), row.answered_at) == (value.choice, expected["ranking"], value.time)
            assert row.seconds == (None if value.seconds is None or value.seconds > 86_400 else value.seconds)
    long = [value for own in by_person.values() for value in own.values() if value.seconds is not None and value.seconds > 86_400]
    assert (exported.batch.batch_id, exported.batch.is_dated, len(exported.left_out)) == ("b1", True, len(long))


@given(
    own=st.dictionaries(st.sampled_from(KEYS), st.none() | answers(), min_size=1),
    at=st.integers(0, 999),
    kind=st.sampled_from(["job", "task"]),
)
def test_cvat_says_what_people_gave(folder: Path, own: dict[Object, Given | None], at: int, kind: str) -> None:
    data = xml(cvat_export(folder, 1, own, "ada", at / 3600, kind))
    if not any(own.values()):
        with pytest.raises(InputError, match=r"answers: none can be taken: image\[\d\]\.tag\[0\]: has no choice"):
            cvat.read_cvat(data, "a.xml", NOBODY)
        return
    exported = cvat.read_cvat(data, "a.xml", NOBODY)
    rows = of(exported.batch.annotations)
    assert rows.keys() == {(*key, "ada") for key, value in own.items() if value is not None}
    for key, value in own.items():
        if value is not None:
            row = rows[(*key, "ada")]
            assert (row.choice, list(row.ranking), row.seconds) == (value.choice, value.as_answer(key, "ada")["ranking"], None)
            assert row.answered_at == START + timedelta(seconds=at)
    assert (exported.batch.is_dated, len(exported.left_out)) == (False, sum(value is None for value in own.values()))


@given(
    names=st.tuples(
        st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,20}", fullmatch=True), st.from_regex(r"[a-z0-9][a-z0-9_.-]{0,20}", fullmatch=True),
        st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,20}", fullmatch=True), st.from_regex(r"[0-9]{4,8}", fullmatch=True),
    ),
    prefix=st.sampled_from(["", "sheets/", "a/b/", "C:\\work\\sheets\\"]),
)  # fmt: skip
def test_images_are_named_so_that_objects_come_back(names: tuple[str, str, str, str], prefix: str) -> None:
    batch, dataset, scan, instance = names
    assert cvat.object_of(prefix + cvat.image_name(batch, f"{dataset}/{scan}", instance)) == (batch, f"{dataset}/{scan}", instance)


@pytest.mark.parametrize(
    "name",
    ["", "photo.jpg", "b1~demo~room_a.jpg", "b1~demo~room_a~1.jpg", "b1~demo~room_a~\u0660\u0660\u0660\u0661.jpg", "~demo~a~0001.jpg"],
)
def test_what_is_named_otherwise_is_no_object(name: str) -> None:
    assert cvat.object_of(name) is None


def test_the_schema_is_one_and_further_fields_are_left_alone(folder: Path) -> None:
    schema = json.loads(label_studio.LABEL_STUDIO_SCHEMA_FILE.read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    export = label_studio_export(folder, 1, {KEYS[0]: [(user("ada"), Given(1))]})
    export[0]["annotations"][0] |= {"last_action": None, "draft_created_at": "x", "unique_id": "u"}
    export[0] |= {"file_upload": "a.json", "inner_id": 1, "comment_count": 0, "agreement": 1.0}
    assert len(label_studio.read_label_studio(json.dumps(export).encode(), "e.json", NOBODY).batch.annotations) == 1


BOMB = (
    '<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa">'
    + "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghi", "bcdefghij", strict=True))
    + "]>"
)
OUTSIDE = '<!DOCTYPE a [<!ENTITY j SYSTEM "file:///etc/hostname">]>'


@pytest.mark.parametrize("head", [BOMB, OUTSIDE, "<!DOCTYPE a>", '<!DOCTYPE a SYSTEM "http://example.org/a.dtd">'])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_entities_are_refused_before_they_grow(folder: Path, head: str, encoding: str) -> None:
    text = xml(cvat_export(folder, 1, {KEYS[0]: Given(1)}, "ada")).decode().partition("?>")[2]
    body = text.replace("manual", "&j;") if "ENTITY" in head else text
    data = f'<?xml version="1.0" encoding="{encoding}"?>{head}{body}'.encode(encoding)
    with pytest.raises(InputError, match=r"a\.xml: document: is no XML that is read \(declares a document type\)"):
        cvat.read_cvat(data, "a.xml", NOBODY)


FIRST = "[0].annotations[0]"


def changed(folder: Path, change: Any) -> bytes:
    root = cvat_export(folder, 1, {key: Given(1, (2, 3)) for key in KEYS}, "ada")
    change(root)
    return xml(root)


def second_tag(root: ElementTree.Element) -> None:
    image = root.findall("image")[1]
    image.append(image[0])


def set_text(path: str, text: str | None) -> Any:
    return lambda root: setattr(root.find(path), "text", text)


@pytest.mark.parametrize(
    ("change", "field", "problem"),
    [
        (lambda root: setattr(root, "tag", "dataset"), "annotations", "is not what it begins with"),
        (set_text("version", "1.0"), "version", "is '1.0', and 1.1 is read"),
        (lambda root: ElementTree.SubElement(root, "track"), "track", "is of an export of videos"),
        (lambda root: root.remove(root.find("meta")), "meta", "has no job"),
        (set_text("meta/job/updated", "yesterday"), "meta.job.updated", "is no time with a zone"),
        (set_text("meta/job/updated", "2026-01-01 10:00:00"), "meta.job.updated", "is no time with a zone"),
        (second_tag, "image[1].tag[1]", "is another 'answer' of one image"),
        (set_text("image[1]/tag/attribute[1]", "11"), "image[0].tag[0].attribute[0]", "'11' is no candidate"),
        (set_text("image[1]/tag/attribute[2]", "none"), "image[0].tag[0].attribute[1]", "'none' is no candidate"),
        (set_text("image[1]/tag/attribute[3]", "2"), "image[0].tag[0]", "ranks candidate 2 twice"),
        (set_text("image[1]/tag/attribute[3]", "1"), "image[0].tag[0]", "ranks candidate 1 twice"),
        (lambda root: root.findall("image")[2].set("name", "photo.jpg"), "image[2].name", "names no object of a batch"),
        (lambda root: root.findall("image")[2].set("name", "b2~demo~room_b~0001.jpg"), "image[2].name", "is of batch 'b2'"),
    ],
)
def test_what_cannot_be_an_answer_in_cvat_is_refused_by_its_place(folder: Path, change: Any, field: str, problem: str) -> None:
    with pytest.raises(InputError) as caught:
        cvat.read_cvat(changed(folder, change), "a.xml", NOBODY)
    assert (caught.value.file, caught.value.field, problem in caught.value.problem) == ("a.xml", field, True), str(caught.value)


def test_other_labels_and_shapes_are_left_out_by_their_place(folder: Path) -> None:
    def change(root: ElementTree.Element) -> None:
        image = root.findall("image")[0]
        ElementTree.SubElement(image, "box", label="answer", xtl="1")
        ElementTree.SubElement(image, "tag", label="blurred")
        ElementTree.SubElement(image[0], "attribute", name="mood").text = "good"

    exported = cvat.read_cvat(changed(folder, change), "a.xml", NOBODY)
    assert len(exported.batch.annotations) == len(KEYS)
    assert exported.left_out == (
        "image[0].box[1]: of the label 'answer', which no answer has", "image[0].tag[2]: of the label 'blurred', which no answer has",
        "image[0].tag[0].attribute[5]: 'mood', which no answer has",
    )  # fmt: skip


def test_an_archive_is_said_to_be_one() -> None:
    with pytest.raises(InputError, match=r"e\.zip: document: is a ZIP archive; unpack it"):
        cvat.read_cvat(b"PK\x03\x04rest", "e.zip", NOBODY)


@pytest.mark.parametrize(
    ("change", "field", "problem"),
    [
        (lambda row: row.update(updated_at="now"), f"{FIRST}.updated_at", "is no time with a zone"),
        (lambda row: row.pop("updated_at"), FIRST, "lacks 'updated_at'"),
        (lambda row: row.update(lead_time=-1), f"{FIRST}.lead_time", "must be at least 0"),
        (lambda row: row.update(completed_by="ada"), f"{FIRST}.completed_by", "must be an object"),
        (lambda row: row.update(completed_by=None), f"{FIRST}.completed_by", "does not say who answered"),
        (lambda row: row["result"].append(row["result"][0]), f"{FIRST}.result[2]", "is another choice"),
        (lambda row: row["result"][0].update(value={"choices": ["1", "2"]}), f"{FIRST}.result[0].value.choices", "one candidate, has 2"),
        (lambda row: row["result"][0].update(value={"choices": ["a"]}), f"{FIRST}.result[0].value.choices", "'a' is no candidate"),
        (lambda row: row["result"][0].update(value={"choices": [1]}), f"{FIRST}.result[0].value.choices[0]", "must be text"),
        (
            lambda row: row["result"][1].update(value={"ranker": {"next": ["none"]}}), f"{FIRST}.result[1].value.ranker.next",
            "'none' is no candidate",
        ),
        (
            lambda row: row["result"][1].update(value={"ranker": {"next": ["2", "1"]}}), f"{FIRST}.result[1].value.ranker.next",
            "ranks candidate 1 twice",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_an_answer_in_label_studio_is_refused_by_its_place(folder: Path, change: Any, field: str, problem: str) -> None:
    export = label_studio_export(folder, 1, {key: [(user("ada"), Given(1, (2, 3)))] for key in KEYS})
    change(export[0]["annotations"][0])
    with pytest.raises(InputError) as caught:
        label_studio.read_label_studio(json.dumps(export).encode(), "e.json", NOBODY)
    assert (caught.value.file, caught.value.field, problem in caught.value.problem) == ("e.json", field, True), str(caught.value)


def test_of_two_answers_of_one_person_the_later_one_holds(folder: Path) -> None:
    ada = user("ada")
    later = label_studio_bytes(folder, {KEYS[0]: [(ada, Given(2, at=2.0)), (ada, Given(1, at=1.0)), (ada, Given(3, at=3.0))]})
    exported = label_studio.read_label_studio(later, "e.json", NOBODY)
    assert [row.choice for row in exported.batch.annotations] == [3]
    assert [line.partition(":")[0] for line in exported.left_out] == ["[0].annotations[1]", "[0].annotations[0]"]
    same = label_studio_bytes(folder, {KEYS[0]: [(ada, Given(2)), (ada, Given(2))]})
    assert len(label_studio.read_label_studio(same, "e.json", NOBODY).batch.annotations) == 1
    contrary = label_studio_bytes(folder, {KEYS[0]: [(ada, Given(2)), (ada, Given(1))]})
    with pytest.raises(InputError, match=r"\[0\]\.annotations\[1\]\.updated_at: is that of \[0\]\.annotations\[0\], too"):
        label_studio.read_label_studio(contrary, "e.json", NOBODY)


def test_one_name_does_not_make_one_of_two_people(folder: Path) -> None:
    two = label_studio_bytes(folder, {KEYS[0]: [(1, Given(2)), (2, Given(1))]})
    with pytest.raises(InputError, match=r"completed_by: is '2', and .*completed_by is '1': one name is not enough"):
        label_studio.read_label_studio(two, "e.json", accounts_of(["ada"]))
    rows = label_studio.read_label_studio(two, "e.json", accounts_of(["1=ada", "bob"])).batch.annotations
    assert [(row.annotator, row.choice) for row in rows] == [("ada", 2), ("bob", 1)]


@pytest.mark.parametrize("values", [[""], ["a="], ["ada", "bob"], ["1=ada", "1=bob"], ["x" * 101], ["1=a\nb"]])
def test_names_that_cannot_be_are_refused(values: list[str]) -> None:
    with pytest.raises(InputError, match=r"^--annotator: "):
        accounts_of(values)
