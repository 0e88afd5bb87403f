"""Annotation: batches of answers from files, all of one or nothing, and whose answer counts."""

from __future__ import annotations

import itertools
import json
import os
import tempfile
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.annotation import Annotation
from schemas.candidates import Candidate
from schemas.capture import Instance
from schemas.errors import InputError
from schemas.record import check
from tasks.annotation import SCHEMA_FILE, STAGE, AnnotationConfig, borda, current, read_batch, run, winning
from tasks.annotation.batch import AnnotationBatch
from tasks.geometry.transforms import flat, is_rigid, matrix, yaw_of, yaw_pose
from tasks.stage import Context
from tests.samples import START, sample

A, B, C = (letter * 64 for letter in "abc")
SCENE = "demo/room_a"


def answer(**values: Any) -> dict[str, Any]:
    given = {"scene_id": SCENE, "instance_id": "0001", "annotator": "ada", "answered_at": "2026-03-01T14:05:00+02:00", "choice": 2}
    return {key: value for key, value in (given | values).items() if value is not ...}


def write(path: Path, *annotations: dict[str, Any], **values: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"batch_id": "batch-1", "annotations": list(annotations)} | values))
    return path


def batch_of(document: dict[str, Any]) -> AnnotationBatch:
    """The batch in one document, read from a file `batch.json`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "batch.json"
        path.write_text(json.dumps(document))
        return read_batch(path)


def instances(scene: str = SCENE) -> list[Instance]:
    rows = [
        sample(
            Instance,
            scene_id=scene,
            instance_id=f"{i:04d}",
            is_structure=i == 9,
            box_pose=flat(yaw_pose(0.1 * i, [i, 0, 0.5])),
            box_size=(1.0, 0.5, 1.0),
        )
        for i in (1, 2, 9)
    ]
    return rows


def candidates(scene: str = SCENE) -> list[Candidate]:
    filled = [(1, A), (2, B), (3, C), (5, B)]
    rows = [
        sample(Candidate, scene_id=scene, instance_id=i, slot=s, asset_id=a, outcome="filled") for i in ("0001", "0002") for s, a in filled
    ]
    return [*rows, *[sample(Candidate, scene_id=scene, instance_id=i, slot=4, asset_id=None, outcome="empty") for i in ("0001", "0002")]]


def imported(path: Path) -> list[Annotation]:
    batch = read_batch(path)
    context = Context(scene_id=batch.batch_id, stage="annotation", seed=0, blobs={})
    rows = run(
        annotation_batch=batch, review_batch=None, instances=instances(), candidates=candidates(), context=context,
        config=AnnotationConfig(),
    ).rows["annotations"]  # fmt: skip
    check(rows, Annotation)
    return rows


def test_an_answer_becomes_a_row(tmp_path: Path) -> None:
    placed = {"position": [1.2, -0.1, 0.05], "yaw_degrees": 30, "scale": [1, 1.1, 0.9]}
    rows = imported(
        write(tmp_path / "b.json", answer(choice=2, ranking=[2, A, 3], transform=placed), answer(instance_id="0002", choice=None))
    )
    first, second = rows
    assert (first.choice, first.ranking) == (B, (B, A, C))
    assert first.answered_at == datetime(2026, 3, 1, 12, 5, tzinfo=UTC)
    assert np.degrees(yaw_of(matrix(first.pose or ()))) == pytest.approx(30)
    assert matrix(first.pose or ())[:3, 3].tolist() == placed["position"]
    assert first.scale == (1.0, 1.1, 0.9)
    assert first.box_pose == instances()[0].box_pose
    assert (second.choice, second.pose, second.scale, second.ranking) == (None, None, None, ())
    assert {row.source_file for row in rows} == {"b.json"}


@pytest.mark.parametrize(("given", "kept"), [(..., None), (None, None), (0, 0.0), (61.5, 61.5), (60, 60.0)])
def test_time_spent_on_an_answer_is_kept_where_it_was_measured(tmp_path: Path, given: Any, kept: float | None) -> None:
    assert [row.seconds for row in imported(write(tmp_path / "b.json", answer(seconds=given)))] == [kept]


@given(yaw=st.floats(-720, 720))
@settings(max_examples=25, deadline=None)
def test_yaw_and_quaternion_say_the_same(yaw: float) -> None:
    half = np.radians(yaw) / 2
    both = [{"yaw_degrees": yaw}, {"rotation_wxyz": [np.cos(half), 0, 0, np.sin(half)]}]
    poses = []
    for index, rotation in enumerate(both):
        document = {
            "batch_id": "b",
            "annotations": [answer(transform={"position": [1, 2, 3], "scale": [1, 1, 1], **rotation}, annotator=str(index))],
        }
        poses.append(np.array(batch_of(document).annotations[0].pose))
    assert np.allclose(poses[0], poses[1], atol=1e-9)
    assert is_rigid(poses[0].reshape(4, 4))


def test_a_batch_may_span_files_in_folders_below(tmp_path: Path) -> None:
    path = write(tmp_path / "b.json", answer(), files=["more/c.json"])
    write(tmp_path / "more" / "c.json", answer(annotator="bob"), files=["d.json"])
    write(tmp_path / "more" / "d.json", answer(annotator="cleo"))
    rows = imported(path)
    assert [(r.annotator, r.source_file) for r in rows] == [("ada", "b.json"), ("bob", "more/c.json"), ("cleo", "more/d.json")]


def transform(**values: Any) -> dict[str, Any]:
    given = {"position": [1, 0, 0], "yaw_degrees": 0, "scale": [1, 1, 1]}
    return {key: value for key, value in (given | values).items() if value is not ...}


WRONG: list[tuple[dict[str, Any], str, str]] = [
    (answer(scene_id=...), "annotations[1]", "scene_id"),
    (answer(scene_id="demo/other"), "annotations[1].scene_id", "not in the lake"),
    (answer(scene_id="../up"), "annotations[1].scene_id", "not allowed"),
    (answer(instance_id="0007"), "annotations[1].instance_id", "no instance 0007"),
    (answer(instance_id="0009"), "annotations[1].instance_id", "part of the room"),
    (answer(instance_id=1), "annotations[1].instance_id", "must be text"),
    (answer(choice=4), "annotations[1].choice", "slot 4"),
    (answer(choice=11), "annotations[1].choice", "at most 10"),
    (answer(choice="d" * 64), "annotations[1].choice", "no candidate"),
    (answer(choice="chair"), "annotations[1].choice", "not allowed"),
    (answer(choice=True), "annotations[1].choice", "must be"),
    (answer(annotator="  "), "annotations[1].annotator", "not allowed"),
    (answer(annotator="ada\nbob"), "annotations[1].annotator", "not allowed"),
    (answer(annotator="\ud800"), "annotations[1].annotator", "not allowed"),
    (answer(instance_id="0001\n"), "annotations[1].instance_id", "not allowed"),
    (answer(answered_at="2026-03-01T14:05:00"), "annotations[1].answered_at", "zone"),
    (answer(answered_at="yesterday"), "annotations[1].answered_at", "zone"),
    (answer(answered_at="0001-01-01T00:00:00+23:00"), "annotations[1].answered_at", "zone"),
    (answer(ranking=[1, 1]), "annotations[1].ranking", "twice"),
    (answer(ranking=[1, 2]), "annotations[1].ranking", "before the choice"),
    (answer(ranking=[2, 4]), "annotations[1].ranking[1]", "slot 4"),
    (answer(comment="nice"), "annotations[1]", "unknown field 'comment'"),
    (answer(seconds=-1), "annotations[1].seconds", "at least 0"),
    (answer(seconds=86401), "annotations[1].seconds", "at most 86400"),
    (answer(seconds="60"), "annotations[1].seconds", "must be"),
    (answer(transform=transform(scale=[1, 1])), "annotations[1].transform.scale", "must have 3 values"),
    (answer(transform=transform(scale=[1, 0, 1])), "annotations[1].transform.scale", "above 0"),
    (answer(transform=transform(scale=[1, -1, 1])), "annotations[1].transform.scale", "mirrored"),
    (answer(transform=transform(scale=[0.01, 0.01, 0.01])), "annotations[1].transform.scale", "not within"),
    (answer(transform=transform(position=["a", 0, 0])), "annotations[1].transform.position[0]", "must be a number"),
    (answer(transform=transform(position=[100, 0, 0])), "annotations[1].transform.position", "from the instance"),
    (answer(transform=transform(position=[10**400, 0, 0])), "annotations[1].transform.position", "too large"),
    (answer(transform=transform(yaw_degrees=...)), "annotations[1].transform", "no rotation"),
    (answer(transform=transform(rotation_wxyz=[1, 0, 0, 0])), "annotations[1].transform", "both"),
    (answer(transform=transform(yaw_degrees=..., rotation_wxyz=[1, 1, 0, 0])), "annotations[1].transform.rotation_wxyz", "length 1.41"),
    (answer(choice=None, transform=transform()), "annotations[1].transform", "nothing was chosen"),
    (answer(), "annotations[1]", "again"),
]


@pytest.mark.parametrize(("wrong", "where", "why"), WRONG, ids=[f"{w[1]}: {w[2]}" for w in WRONG])
def test_a_wrong_answer_is_refused_with_its_place(tmp_path: Path, wrong: dict[str, Any], where: str, why: str) -> None:
    """The first answer is fine, the second is not: nothing is imported."""
    if wrong.get("annotator") == "ada" and wrong != answer():
        wrong = wrong | {"annotator": "bob"}
    with pytest.raises(InputError) as caught:
        imported(write(tmp_path / "b.json", answer(), wrong))
    assert caught.value.file == "b.json"
    assert caught.value.field == where
    assert why in str(caught.value)
    assert "\n" not in str(caught.value)


CONTENT: list[tuple[bytes, str]] = [
    (b"", "not JSON"),
    (b"{", "not JSON"),
    (b"[]", "an object"),
    (b"null", "an object"),
    (b"\xff\xfe", "UTF-8"),
    (b'{"batch_id": "b", "annotations": [NaN]}', "NaN"),
    (b'{"batch_id": "b", "batch_id": "c"}', "twice"),
    (b'{"annotations": []}', "batch_id"),
    (b'{"batch_id": "a b"}', "not allowed"),
    (b'{"batch_id": "b"}', "annotations: the batch has no answers"),
    (b'{"batch_id": "b", "annotations": [], "files": []}', "annotations: the batch has no answers"),
    (b'{"batch_id": "b", "annotations": {}}', "a list"),
    (b"[" * 100_000, "nested"),
    (b'{"batch_id": ' + b"9" * 10_000 + b"}", "digits"),
]


@pytest.mark.parametrize(("content", "why"), CONTENT, ids=range(len(CONTENT)))
def test_a_file_that_is_no_batch_is_refused(tmp_path: Path, content: bytes, why: str) -> None:
    path = tmp_path / "b.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"^b\.json") as caught:
        read_batch(path)
    assert why in str(caught.value)


@pytest.mark.parametrize(
    "name",
    [
        "../c.json",
        "/etc/passwd",
        "x/../../c.json",
        "..\\c.json",
        "C:/c.json",
        "link.json",
        "linked/c.json",
        "none.json",
        ".",
        "x" * 5000,
        "\0",
        "\ud800",
        "loop",
    ],
)
def test_a_path_out_of_the_folder_is_refused(tmp_path: Path, name: str) -> None:
    outside = write(tmp_path / "c.json", answer(annotator="eve"))
    inside = tmp_path / "in"
    inside.mkdir()
    os.symlink(outside, inside / "link.json")
    os.symlink(tmp_path, inside / "linked")
    os.symlink("loop", inside / "loop")
    with pytest.raises(InputError) as caught:
        read_batch(write(inside / "b.json", answer(), files=[name]))
    assert caught.value.field == "files[0]"
    assert str(tmp_path) not in str(caught.value)


@pytest.mark.parametrize("files", [["b.json"], ["c.json", "c.json"]])
def test_a_file_named_twice_is_refused(tmp_path: Path, files: list[str]) -> None:
    write(tmp_path / "c.json", answer(annotator="bob"))
    with pytest.raises(InputError, match="named twice"):
        read_batch(write(tmp_path / "b.json", answer(), files=files))


def test_files_without_an_answer_among_them_are_refused(tmp_path: Path) -> None:
    write(tmp_path / "c.json")
    with pytest.raises(InputError, match=r"^b\.json: annotations: the batch has no answers"):
        read_batch(write(tmp_path / "b.json", files=["c.json"]))
    with pytest.raises(InputError, match=r"^batch\.json: annotations: the batch has no answers"):
        batch_of({"batch_id": "b", "annotations": []})
    write(tmp_path / "c.json", answer())
    assert len(read_batch(tmp_path / "b.json").annotations) == 1


def test_files_of_another_batch_are_refused(tmp_path: Path) -> None:
    write(tmp_path / "c.json", answer(annotator="bob"), batch_id="batch-2")
    with pytest.raises(InputError, match="batch-2"):
        read_batch(write(tmp_path / "b.json", answer(), files=["c.json"]))


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["scene_id", "choice", "scale", "transform", "x"]), inner, max_size=3)
    ),
    max_leaves=8,
)


@given(field=st.sampled_from([*answer(), "transform", "ranking", "seconds", "other"]), value=json_values)
@settings(max_examples=150, deadline=None)
def test_whatever_a_field_holds_the_batch_is_taken_or_refused_with_one_line(field: str, value: Any) -> None:
    document = {"batch_id": "b", "annotations": [answer() | {field: value}]}
    valid = not list(jsonschema.Draft202012Validator(json.loads(SCHEMA_FILE.read_text())).iter_errors(document))
    refused = None
    try:
        batch = batch_of(document)
    except InputError as error:
        refused = error
    if refused is None:
        assert valid
        assert len(batch.annotations) == 1
    else:
        assert "\n" not in str(refused)
        assert refused.field.startswith("annotations[0]") or refused.problem.endswith("Infinity, which JSON does not have")


def test_the_published_schema_is_a_schema() -> None:
    jsonschema.Draft202012Validator.check_schema(json.loads(SCHEMA_FILE.read_text()))
    assert STAGE.grain == "annotation_batch"


def row(
    annotator: str, choice: str | None, ranking: tuple[str, ...] = (), at: int = 0, batch: str = "b", instance: str = "0001"
) -> Annotation:
    return sample(
        Annotation, scene_id=SCENE, annotator=annotator, choice=choice, ranking=ranking,
        answered_at=START + timedelta(seconds=at), batch_id=batch, instance_id=instance,
        box_pose=flat(np.eye(4)), box_size=(1.0, 1.0, 1.0),
    )  # fmt: skip


WINS: dict[str, tuple[list[Annotation], str | None, str]] = {
    "one answer": ([row("ada", A)], A, "ada"),
    "majority": ([row("ada", A), row("bob", B), row("cleo", B)], B, "bob"),
    "majority over newer": ([row("ada", A, at=9), row("bob", B), row("cleo", B)], B, "bob"),
    "none fits is a choice": ([row("ada", None), row("bob", None), row("cleo", B)], None, "ada"),
    "newest of the majority": ([row("ada", B, at=1), row("bob", B, at=5), row("cleo", A, at=9)], B, "bob"),
    "an older batch is history": ([row("ada", A, batch="old", at=0), row("ada", B, batch="new", at=5), row("bob", B)], B, "ada"),
    "votes of history do not count": ([row("ada", A, batch="b1"), row("ada", A, batch="b2", at=1), row("bob", B, at=0)], A, "ada"),
    "tie by Borda": ([row("ada", A, (A, B, C)), row("bob", B, (B, C, A), at=5)], B, "bob"),
    "tie by Borda against newer": ([row("ada", A, (A, C, B), at=0), row("bob", B, (B, A, C), at=5)], A, "ada"),
    "tie by time": ([row("ada", A), row("bob", B, at=1)], B, "bob"),
    "tie by name": ([row("bob", B), row("ada", A)], A, "ada"),
}


@pytest.mark.parametrize("name", WINS)
def test_whose_answer_counts(name: str) -> None:
    rows, choice, annotator = WINS[name]
    for order in itertools.permutations(rows):
        winner = winning(order)["0001"]
        assert (winner.choice, winner.annotator) == (choice, annotator)


@st.composite
def answers(draw: st.DrawFn) -> list[Annotation]:
    rows = {}
    for _ in range(draw(st.integers(1, 8))):
        choice = draw(st.sampled_from([A, B, C, None]))
        rest = draw(st.permutations([x for x in (A, B, C) if x != choice]))
        ranking = tuple(([choice] if choice else []) + rest[: draw(st.integers(0, len(rest)))])
        made = row(
            draw(st.sampled_from(["ada", "bob", "cleo", "dan"])),
            choice,
            ranking,
            draw(st.integers(0, 3)),
            draw(st.sampled_from(["b1", "b2"])),
        )
        rows[made.annotator, made.batch_id] = made
    return list(rows.values())


@given(rows=answers(), shuffle=st.randoms(use_true_random=False))
@settings(max_examples=100, deadline=None)
def test_agreement_keeps_its_promises(rows: list[Annotation], shuffle: Any) -> None:
    winner, counting = winning(rows)["0001"], current(rows)
    assert winner in counting
    assert sorted(r.annotator for r in counting) == sorted({r.annotator for r in rows})
    votes = [sum(r.choice == choice for r in counting) for choice in (A, B, C, None)]
    assert sum(r.choice == winner.choice for r in counting) == max(votes)
    mixed = list(rows)
    shuffle.shuffle(mixed)
    assert winning(mixed) == winning(rows)
    counts = borda(counting)
    rankings = sum(1 for r in counting if r.choice or r.ranking)
    assert sum(counts.values()) == rankings * len(counts) * (len(counts) - 1) // 2


def test_instances_do_not_mix() -> None:
    rows = [row("ada", A), row("ada", B, instance="0002"), row("bob", B, instance="0002")]
    assert {name: won.choice for name, won in winning(rows).items()} == {"0001": A, "0002": B}


def test_ranked_slots_that_hold_one_asset_are_one_candidate(tmp_path: Path) -> None:
    assert imported(write(tmp_path / "b.json", answer(choice=5, ranking=[2, 5, 1])))[0].ranking == (B, A)


@pytest.mark.parametrize("wrong", [lambda p: p.parent / "none.json", lambda p: p.parent])
def test_no_file_is_said(tmp_path: Path, wrong: Callable[[Path], Path]) -> None:
    with pytest.raises(InputError, match="is no file"):
        read_batch(wrong(tmp_path / "b.json"))
