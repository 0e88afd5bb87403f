"""Ten thousand annotation files that are nearly right: each is taken as it stands, or refused with the name of a field; none by half."""

from __future__ import annotations

import functools
import json
import shutil
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

import jsonschema
import numpy as np
import pytest

from flows.inputs.annotation import BatchPlan, create_batch, import_annotations
from flows.inputs.annotation.importing import held_against
from flows.run.configuration import configure
from schemas.annotation import Annotation, Assignment
from schemas.candidates import Candidate
from schemas.errors import InputError
from schemas.record import check
from tasks.annotation import SCHEMA_FILE
from tasks.annotation.batch import read_batch
from tests.annotated import SCENES, annotatable, answer, fill
from tests.fuzzing.mutations import changed_file
from warehouse.lake import Lake

FILES = 10_000
ALIKE = ["ada", "bob", "eve", "", " ada", "0001", "0002", "0004", "0009", "9999", *SCENES, "demo/none", "b0", "b1", 1, 2, 3, 4, 10, 11]
"""Values of the right kind, many of them another answer's."""

OF_THE_WHOLE = ("is nested", "holds the number", "holds numbers", "holds a number", "gives", "is larger", "needs", "has more", "holds more")
"""How refusals of files begin in which no field can be named, since they were not read to the end."""


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    folder = tmp_path_factory.mktemp("mutations")
    lake = annotatable(folder / "lake", objects=2)
    create_batch(lake, BatchPlan("b1", ("ada", "bob"), 2), folder / "work")
    fill(folder / "work", np.random.default_rng(0))
    work = json.loads((folder / "work/work.json").read_text())
    first = json.loads((folder / "work" / work["annotators"][0]["answers"]).read_text())
    first["annotations"] = first["annotations"][:2]
    (folder / "part.json").write_text(json.dumps({key: first[key] for key in ("batch_id", "annotations")}))
    import_annotations(lake, folder / "part.json")
    return lake


class Cached:
    """A snapshot whose rows are read once."""

    def __init__(self, lake: Lake) -> None:
        reader = lake.snapshot()
        self.rows = functools.cache(reader.rows)

    def rows_by_key(self, record: type, keys: Any) -> list[Any]:
        return [row for row in self.rows(record) if row.batch_id in set(keys)]


def sound(batch: str) -> dict[str, Any]:
    """Answers with everything that they may have, corrections and a withdrawal among them."""
    placed = {"position": [-1.9, -2.0, 0.0], "yaw_degrees": 10, "scale": [1, 1.1, 0.9]}
    turned = {"position": [-1.2, -2.0, 0.0], "rotation_wxyz": [1, 0, 0, 0], "scale": [1, 1, 1]}
    rows = [
        answer(SCENES[0], "0001", "ada", 1, at=5, transform=placed, ranking=[1, 3, 2], seconds=3.5),
        answer(SCENES[0], "0002", "ada", 2, at=5, transform=turned),
        answer(SCENES[1], "0001", "bob", 3, at=6, tool="blender"),
        answer(SCENES[1], "0002", "bob", None, at=6),
    ]
    if batch == "b1":
        rows[1] = answer(SCENES[0], "0002", "ada", None, at=7, withdrawn=True)
        del rows[1]["choice"]
    return {"batch_id": batch, "tool": "page", "annotations": rows}


def mutated(number: int) -> bytes:
    """A sound file with one to three changes: of a value to one that somebody else has, of JSON's structure, of its bytes."""
    random = Random(number)
    document = sound(random.choice(["b0", "b1"]))
    data = json.dumps(document).encode()
    for _ in range(random.choice([1, 1, 2, 3])):
        if random.random() < 0.5:
            try:
                value = json.loads(data)
                row = random.choice(value["annotations"])
                row[random.choice([*row, "withdrawn", "ranking", "seconds", "choice"])] = random.choice(
                    [*ALIKE, True, None, [], [1, 2], 0.5]
                )
                data = json.dumps(value).encode()
                continue
            except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError):
                pass
        data = changed_file("batch.json", data, random)
    return data


def as_given(row: Annotation, item: dict[str, Any], tool: str | None, slots: dict[int, str]) -> bool:
    """Whether a row says what the file says."""

    def asset(value: Any) -> Any:
        return slots.get(int(value)) if isinstance(value, int | float) else value

    transform = item.get("transform")
    ranking = list(dict.fromkeys(asset(value) for value in item.get("ranking") or ()))
    place = None if row.pose is None else [row.pose[3], row.pose[7], row.pose[11]]
    return (
        (row.scene_id, row.instance_id, row.annotator) == (item["scene_id"], item["instance_id"], item["annotator"].strip())
        and row.choice == asset(item.get("choice"))
        and list(row.ranking) == ranking
        and (place is None) == (transform is None)
        and (transform is None or (np.allclose(place, transform["position"]) and np.allclose(row.scale, transform["scale"])))
        and (row.seconds is None) == (item.get("seconds") is None)
        and row.is_withdrawn == item.get("withdrawn", False)
        and row.tool == (item.get("tool") or tool)
        and row.is_simulated == item.get("simulated", False)
    )


@pytest.mark.slow
@pytest.mark.whole
def test_ten_thousand_files_are_taken_as_they_stand_or_refused_with_a_field(lake: Lake, tmp_path: Path) -> None:
    schema = jsonschema.Draft202012Validator(json.loads(SCHEMA_FILE.read_text()))
    asked = {(row.scene_id, row.instance_id, row.annotator) for row in lake.snapshot().rows(Assignment)}
    slots = {row.slot: row.asset_id for row in lake.snapshot().rows(Candidate, SCENES[0]) if row.instance_id == "0001"}
    cached, configuration = Cached(lake), configure()
    before = lake.snapshot().snapshot_id
    fields: Counter[str] = Counter()
    taken = 0
    file = tmp_path / "batch.json"
    for number in range(FILES):
        data = mutated(number)
        file.write_bytes(data)
        refused: InputError | None = None
        try:
            held = held_against(cached, read_batch(file), file.name, configuration)  # type: ignore[arg-type]
        except InputError as error:
            refused = error
        if refused is not None:
            assert "\n" not in str(refused), number
            assert refused.file == "batch.json", number
            assert refused.field or refused.problem.startswith(OF_THE_WHOLE), (number, str(refused))
            fields[refused.field.rpartition(".")[2].partition("[")[0]] += 1
            continue
        taken += 1
        document = json.loads(data.decode("utf-8-sig"))
        assert schema.is_valid(document), number
        check(held.given, Annotation)
        items = {(item["scene_id"], item["instance_id"], item["annotator"].strip()): item for item in document["annotations"]}
        assert len(held.given) == len(document["annotations"]) == len(items), "all of it"
        for row in held.given:
            key = (row.scene_id, row.instance_id, row.annotator)
            assert as_given(row, items[key], document.get("tool"), slots), (number, row, items[key])
            assert document["batch_id"] != "b1" or key in asked, number
        if number % 50 == 0:
            _import_whole(lake, tmp_path / "copy", file, held.new)
    assert lake.snapshot().snapshot_id == before
    assert taken > FILES // 20
    named = {"annotator", "scene_id", "instance_id", "choice", "ranking", "answered_at", "transform", "withdrawn", "seconds", "batch_id"}
    assert named <= set(fields), fields


def _import_whole(lake: Lake, folder: Path, file: Path, new: tuple[Annotation, ...]) -> None:
    """Import a file into a copy of the lake: all that is new of it is there then, and nothing else."""
    shutil.rmtree(folder, ignore_errors=True)
    copy = Lake.open(shutil.copytree(lake.address, folder))
    import_annotations(copy, file)
    assert len(copy.snapshot().rows(Annotation)) == len(lake.snapshot().rows(Annotation)) + len(new)
