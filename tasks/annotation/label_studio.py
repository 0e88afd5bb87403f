"""Label Studio: a batch's objects as tasks with a labeling config for them, and answers from what a project exports as JSON.

Pictures are addressed as Label Studio serves local files whose root is the batch's folder.
"""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from schemas.errors import InputError
from tasks.annotation.batch import moment
from tasks.annotation.exported import NONE, SLOTS, Accounts, ExportedAnswer, ExportedBatch, exported_batch, ranking_of
from tasks.batches import BatchSchema, parse_json

LABEL_STUDIO_SCHEMA_FILE = Path(__file__).with_name("label_studio.schema.json")
"""What is read of an export."""

SCHEMA = BatchSchema(LABEL_STUDIO_SCHEMA_FILE)

CONFIG_FILE = "label-studio/config.xml"

CHOICE, RANKING, NEXT = "choice", "ranking", "next"
"""Names of the config's two controls, and of the bucket with what comes after the choice."""

_SERVED = "/data/local-files/?d="


def tasks_file(place: int) -> str:
    """The tasks of an annotator, by their place among the batch's."""
    return f"label-studio/{place:03d}.json"


def tasks_of(batch_id: str, objects: Sequence[Mapping[str, Any]], sheets: Mapping[tuple[str, str], str]) -> list[dict[str, Any]]:
    """Objects of a batch's document as tasks, in their order. `sheets`: file of every object's picture, by scene and instance."""
    return [
        {
            "data": {
                "batch_id": batch_id,
                "scene_id": row["scene_id"],
                "instance_id": row["instance_id"],
                "title": f"{row['scene_id']} {row['instance_id']}: {row['caption'] or row['category']}",
                "sheet": _SERVED + sheets[row["scene_id"], row["instance_id"]],
                "photo": None if row["view"] is None else _SERVED + row["view"],
                "candidates": [_item(candidate) for candidate in row["candidates"]],
            }
        }
        for row in objects
    ]


def _item(candidate: Mapping[str, Any]) -> dict[str, str]:
    """A candidate in the list that is ranked."""
    picture = html.escape(_SERVED + candidate["thumbnail"])
    return {"id": str(candidate["slot"]), "title": str(candidate["slot"]), "html": f'<img src="{picture}">'}


def labeling_config() -> str:
    """The labeling config for these tasks, XML."""
    view = ElementTree.Element("View")
    ElementTree.SubElement(view, "Header", value="$title")
    ElementTree.SubElement(view, "Image", name="sheet", value="$sheet")
    choices = ElementTree.SubElement(
        view, "Choices", name=CHOICE, toName="sheet", choice="single", showInline="true", required="true", requiredMessage="Choose one"
    )
    for value in (*SLOTS, NONE):
        ElementTree.SubElement(choices, "Choice", value=value)
    ElementTree.SubElement(view, "List", name="candidates", value="$candidates", title="Candidates")
    ranker = ElementTree.SubElement(view, "Ranker", name=RANKING, toName="candidates")
    ElementTree.SubElement(ranker, "Bucket", name=NEXT, title="Next best: 2nd to 5th, from the top")
    ElementTree.indent(view)
    return ElementTree.tostring(view, encoding="unicode") + "\n"


def read_label_studio(data: bytes, name: str, accounts: Accounts) -> ExportedBatch:
    """The answers in a JSON export; `name` is what errors call it. Skipped tasks, answers without a choice and what was given in
    controls of others are left out.

    Raises:
        InputError: the file is no such export, an answer contradicts itself, or as `exported_batch`. Names the JSON path.
    """
    document = parse_json(data, name)
    SCHEMA.check(document, name)
    answers: list[ExportedAnswer] = []
    left_out: list[str] = []
    for index, task in enumerate(document):
        for number, annotation in enumerate(task["annotations"]):
            where = f"[{index}].annotations[{number}]"
            if annotation.get("was_cancelled"):
                left_out.append(f"{where}: was skipped")
                continue
            answer = _answer(task["data"], annotation, name, where, f"[{index}].data", left_out)
            if answer is not None:
                answers.append(answer)
    return exported_batch(answers, left_out, name, accounts, "Label Studio")


def _answer(
    data: Mapping[str, Any], annotation: Mapping[str, Any], name: str, where: str, object_field: str, left_out: list[str]
) -> ExportedAnswer | None:
    """An annotation as an answer; None where it has no choice."""
    controls: dict[str, tuple[str, Mapping[str, Any]]] = {}
    for number, result in enumerate(annotation["result"]):
        control, place = result.get("from_name"), f"{where}.result[{number}]"
        if control not in (CHOICE, RANKING):
            left_out.append(f"{place}: of the control {control!r:.60}, which no answer has")
            continue
        if control in controls:
            raise InputError(name, place, f"is another {control}", "give one answer in one annotation")
        controls[control] = (place, result.get("value") or {})
    if CHOICE not in controls:
        left_out.append(f"{where}: has no choice")
        return None
    place, value = controls[CHOICE]
    field = f"{place}.value.choices"
    words = value.get("choices", [])
    if len(words) != 1:
        raise InputError(name, field, f"must be one candidate, has {len(words)}", f"choose one, or {NONE!r}")
    choice = None if words[0] == NONE else _slot(words[0], name, field)
    ranking: tuple[int, ...] = ()
    if RANKING in controls:
        place, value = controls[RANKING]
        field = f"{place}.value.ranker.{NEXT}"
        ranking = ranking_of(choice, [_slot(word, name, field) for word in value.get("ranker", {}).get(NEXT, ())], name, field)
    seconds = annotation.get("lead_time")
    return ExportedAnswer(
        batch_id=data["batch_id"],
        scene_id=data["scene_id"],
        instance_id=data["instance_id"],
        accounts=_accounts(annotation.get("completed_by")),
        answered_at=moment(annotation["updated_at"], name, f"{where}.updated_at"),
        choice=choice,
        ranking=ranking,
        seconds=None if seconds is None else float(seconds),
        where=where,
        object_field=object_field,
        account_field=f"{where}.completed_by",
        time_field=f"{where}.updated_at",
    )


def _accounts(user: Any) -> tuple[str, ...]:
    """What Label Studio calls a user: by address and name where it exports them, by number else."""
    stated = [user.get("email"), user.get("username"), user.get("id")] if isinstance(user, dict) else [user]
    words = [str(int(value)) if isinstance(value, int | float) else value.strip() for value in stated if value is not None]
    return tuple(word for word in words if word)


def _slot(word: str, name: str, field: str) -> int:
    if word not in SLOTS:
        raise InputError(name, field, f"{word!r:.40} is no candidate", f"allowed are {SLOTS[0]} to {SLOTS[-1]}, and {NONE!r} as the choice")
    return int(word)
