"""Whom to ask about what: instances by how doubtful their present choice is, and a balanced assignment of them to annotators."""

from __future__ import annotations

import dataclasses
from collections import Counter, defaultdict
from collections.abc import Collection, Sequence

import numpy as np

from schemas.annotation import Annotation
from schemas.capture import Instance
from schemas.errors import InputError
from schemas.optimization import Certificate
from schemas.selection import Selection

LOW_SCORE = 0.5
"""A selection that scores less covers its instance badly or stands where it was not seen."""

UNANSWERED, DISAGREEMENT, UNSTABLE = 0.25, 0.5, 0.5
"""What each reason adds to an object's doubt, beside what its score lacks; see `doubts`."""


@dataclasses.dataclass(frozen=True)
class Task:
    """An instance to ask about. `doubt`: 0 to 1. `reasons`: why it is doubtful. `proposed`: the asset that selection ranks first."""

    scene_id: str
    instance_id: str
    doubt: float
    reasons: tuple[str, ...]
    proposed: str | None


def doubts(
    instances: Sequence[Instance], selections: Sequence[Selection], answers: Sequence[Annotation], certificates: Sequence[Certificate]
) -> list[Task]:
    """All objects that have candidates, the most doubtful first; those of equal doubt by scene and instance.

    Doubt joins what the best score lacks and the reasons that hold, each 0 to 1, as 1 - (1 - a)(1 - b)...: any of them alone makes an
    object doubtful, and none makes up for another. `answers`: the last revision of each annotator, of whatever batch.
    """
    best: dict[tuple[str, str], Selection] = {}
    for selection in sorted(selections, key=lambda row: row.rank, reverse=True):
        best[selection.scene_id, selection.instance_id] = selection
    choices: dict[tuple[str, str], dict[str, str | None]] = defaultdict(dict)
    for answer in sorted(answers, key=lambda row: row.answered_at):
        choices[answer.scene_id, answer.instance_id][answer.annotator] = answer.choice
    unstable = {(row.scene_id, row.instance_id) for row in certificates if not row.is_stable_5cm}
    tasks = []
    for instance in instances:
        key = (instance.scene_id, instance.instance_id)
        if instance.is_structure or key not in best:
            continue
        given = Counter(choices[key].values())
        parts, reasons = [1.0 - best[key].score], [f"low score {best[key].score:.2f}"] if best[key].score < LOW_SCORE else []
        if not given:
            parts.append(UNANSWERED)
            reasons.append("never answered")
        elif len(given) > 1:
            parts.append(DISAGREEMENT)
            reasons.append(f"{given.total()} annotators chose {len(given)} ways")
        if key in unstable:
            parts.append(UNSTABLE)
            reasons.append("unstable")
        doubt = round(1.0 - float(np.prod([1.0 - part for part in parts])), 9)
        tasks.append(Task(*key, min(1.0, max(0.0, doubt)), tuple(reasons), best[key].asset_id))
    return sorted(tasks, key=lambda task: (-task.doubt, task.scene_id, task.instance_id))


def picked(tasks: Sequence[Task], pick: str, answered: Collection[tuple[str, str]], count: int | None) -> list[Task]:
    """The tasks of a batch: those of a `pick` (`schemas.annotation.PICKS`), at most `count`, sorted by scene and instance, the doubtful
    ones by doubt.

    `answered`: scene and instance of what somebody answered for.

    Raises:
        InputError: nothing is left to ask about.
    """
    chosen = [task for task in tasks if pick != "new" or (task.scene_id, task.instance_id) not in answered]
    if pick != "doubtful":
        chosen = sorted(chosen, key=lambda task: (task.scene_id, task.instance_id))
    if not chosen:
        remedy = "give --pick all, to ask again" if tasks else "run the scenes until selection first"
        raise InputError("--pick", pick, "no object is left to ask about", remedy)
    return chosen if count is None else chosen[:count]


def assigned(tasks: Sequence[Task], annotators: Sequence[str], overlap: int, rng: np.random.Generator) -> list[tuple[Task, str, int]]:
    """Every task with each of `overlap` annotators, and its place in that annotator's list, from 1 on.

    Loads differ by one at most. Who shares a task with whom is drawn, so that any two annotators can be compared.

    Raises:
        InputError: there are fewer annotators than are to answer for one instance, or one is named twice.
    """
    if len({name.strip().lower() for name in annotators}) != len(annotators):
        raise InputError("--annotator", ", ".join(annotators), "names somebody twice", "name each annotator once")
    if not 1 <= overlap <= len(annotators):
        raise InputError("--overlap", str(overlap), f"there are {len(annotators)} annotators", f"give 1 to {len(annotators)}")
    loads = dict.fromkeys(sorted(annotators), 0)
    rows = []
    for task in tasks:
        order = rng.permutation(len(loads))
        names = [name for _, _, name in sorted((loads[name], place, name) for place, name in zip(order, loads, strict=True))]
        for name in sorted(names[:overlap]):
            loads[name] += 1
            rows.append((task, name, loads[name]))
    return rows
