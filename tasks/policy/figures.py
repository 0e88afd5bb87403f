"""How well a policy tells the right actions of walks that it did not learn from."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.evaluation import ACTIONS
from tasks.policy.actions import FORWARD, START, UNKNOWN
from tasks.policy.demonstrations import AgentWalk
from tasks.policy.model.objective import logits_of
from tasks.policy.model.shapes import Vocabulary
from tasks.selection.metrics.bootstrap import ConfidenceInterval, interval

MAJORITY, REPEAT = "majority", "repeat"
"""What a policy is held against: the action that is right most often in training, and the last action once more."""


@dataclasses.dataclass(frozen=True)
class Predictions:
    """What was told of the steps of walks whose right action is known. rooms: Of the steps (n,). targets, actions, untold: The right
    action, the policy's, and the policy's where nothing is told of last actions, shape (n,). last: Actions before (n,)."""

    rooms: list[str]
    targets: NDArray[np.int64]
    actions: NDArray[np.int64]
    untold: NDArray[np.int64]
    last: NDArray[np.int64]


def predictions_of(module: Any, walks: Sequence[AgentWalk], observations: Iterable[NDArray[Any]], vocabulary: Vocabulary) -> Predictions:
    """What a network tells of walks by what was seen on them."""
    rooms: list[str] = []
    parts: list[tuple[NDArray[np.int64], ...]] = []
    for walk, seen in zip(walks, observations, strict=True):
        actions, untold = (logits_of(module, walk, seen, vocabulary, tells_last=tells).argmax(axis=-1) for tells in (True, False))
        known = walk.targets != UNKNOWN
        rooms += [walk.room_id] * int(known.sum())
        parts.append((walk.targets[known], actions[known], untold[known], walk.last[known]))
    return Predictions(rooms, *(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def figures_of(predictions: Predictions, majority: int, seed: int) -> list[tuple[str, str, ConfidenceInterval]]:
    """Shares of right actions, all and by the right action, with intervals over rooms: whose ('' for the policy), metric and share.

    majority: The action that is right most often in training.
    """
    right = (predictions.actions == predictions.targets).astype(np.float64)
    repeated = np.where(predictions.last == START, FORWARD, predictions.last)
    kinds: list[tuple[str, str, NDArray[np.float64]]] = [
        ("", "action_accuracy", right),
        ("", "action_accuracy_untold", (predictions.untold == predictions.targets).astype(np.float64)),
        (MAJORITY, "action_accuracy", (predictions.targets == majority).astype(np.float64)),
        (REPEAT, "action_accuracy", (predictions.targets == repeated).astype(np.float64)),
    ]
    kinds += [("", f"accuracy_{name}", np.where(predictions.targets == action, right, np.nan)) for action, name in enumerate(ACTIONS)]
    made = [(method, metric, interval(values, predictions.rooms, seed)) for method, metric, values in kinds]
    return [figure for figure in made if figure[2].examples]
