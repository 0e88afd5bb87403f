"""Verdicts on sampled answers as JSON: read, checked against `verdicts.schema.json`, refused with one line that says where."""

from __future__ import annotations

import dataclasses
from datetime import datetime
from pathlib import Path
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.annotation.batch import moment
from tasks.batches import BatchSchema, parse_json, read_limited

VERDICTS_SCHEMA_FILE = Path(__file__).with_name("verdicts.schema.json")
"""The published JSON Schema of a file of verdicts."""

SCHEMA = BatchSchema(VERDICTS_SCHEMA_FILE)


@dataclasses.dataclass(frozen=True)
class GivenVerdict:
    """What a reviewer says of an answer. `where`: its JSON path in `source_file`."""

    scene_id: str
    instance_id: str
    annotator: str
    passes: bool
    remark: str | None
    reviewed_at: datetime
    where: str

    @property
    def key(self) -> tuple[str, str, str]:
        """What the answer goes by."""
        return self.scene_id, self.instance_id, self.annotator


@dataclasses.dataclass(frozen=True)
class VerdictBatch:
    """One reviewer's verdicts on answers of one batch."""

    batch_id: str
    reviewer: str
    verdicts: tuple[GivenVerdict, ...]
    source_file: str
    is_simulated: bool = False


def load_review_file(path: Path) -> Any:
    """The JSON value of a file of reviews or verdicts; one of verdicts has the field of that name.

    Raises:
        InputError: it cannot be read, or is no JSON.
    """
    if not path.is_file():
        raise InputError(str(path), "", "is no file", "name a JSON file with reviews of an annotation batch, or verdicts on its sample")
    return parse_json(read_limited(path, path.name, BUDGET.review_bytes), path.name)


def read_verdicts(document: Any, name: str) -> VerdictBatch:
    """The verdicts in a JSON value; `name` is what errors call it.

    Raises:
        InputError: it breaks the schema, an answer is judged twice, or one that fails has no remark: its annotator must know what to
            mend. Names the JSON path.
    """
    SCHEMA.check(document, name)
    verdicts: dict[tuple[str, str, str], GivenVerdict] = {}
    for index, item in enumerate(document["verdicts"]):
        where = f"verdicts[{index}]"
        remark = (item.get("remark") or "").strip() or None
        given = GivenVerdict(
            scene_id=item["scene_id"],
            instance_id=item["instance_id"],
            annotator=item["annotator"].strip(),
            passes=item["passes"],
            remark=remark,
            reviewed_at=moment(item["reviewed_at"], name, f"{where}.reviewed_at"),
            where=where,
        )
        if given.key in verdicts:
            raise InputError(name, where, f"judges the same answer as {verdicts[given.key].where}", "judge every answer once")
        if not given.passes and remark is None:
            raise InputError(name, f"{where}.remark", "is missing", "say what is to be mended in an answer that fails")
        verdicts[given.key] = given
    return VerdictBatch(
        document["batch_id"], document["reviewer"].strip(), tuple(verdicts.values()), name, bool(document.get("simulated", False))
    )
