"""What Label Studio and CVAT import, in the folder of a batch: a picture of every object, and what each annotator is asked."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from schemas.budget import BUDGET
from schemas.files import read_file
from tasks.annotation.cvat import LABELS_FILE, image_name, images_file, labels
from tasks.annotation.label_studio import CONFIG_FILE, labeling_config, tasks_file, tasks_of


def write_handouts(folder: Path, document: Mapping[str, Any]) -> None:
    """Write what the tools import into a folder that has all files which the batch's document names; same rows, same bytes.

    Annotators are numbered as in the document, and asked in its order.
    """
    from tasks.stats.object_sheets import object_sheet, seen

    def content(name: str) -> bytes:
        return read_file(folder / name, name, BUDGET.asset_bytes)

    batch_id = document["batch_id"]
    for name in ("sheets", "label-studio", "cvat"):
        (folder / name).mkdir()
    objects = {(row["scene_id"], row["instance_id"]): row for row in document["objects"]}
    sheets = {key: f"sheets/{image_name(batch_id, *key)}" for key in objects}
    for key, row in objects.items():
        view, mesh = (None if row[name] is None else content(row[name]) for name in ("view", "mesh"))
        photo = seen(view, mesh, math.radians(row["box"]["yaw_degrees"]))
        candidates = [(candidate["slot"], content(candidate["thumbnail"])) for candidate in row["candidates"]]
        (folder / sheets[key]).write_bytes(object_sheet(f"{' '.join(key)}: {row['category']}", photo, candidates))
    (folder / CONFIG_FILE).write_text(labeling_config(), encoding="utf-8")
    _write_json(folder / LABELS_FILE, labels())
    for place, row in enumerate(document["annotators"], 1):
        keys = [(asked["scene_id"], asked["instance_id"]) for asked in row["objects"]]
        _write_json(folder / tasks_file(place), tasks_of(batch_id, [objects[key] for key in keys], sheets))
        (folder / images_file(place)).write_text("".join(f"{sheets[key]}\n" for key in keys), encoding="utf-8")


def _write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
