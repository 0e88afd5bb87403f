"""Training examples: objects with their candidates and what annotators said of them, clouds kept once for each asset."""

from __future__ import annotations

import dataclasses
import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tasks.selection.model.clouds import Array, unpacked
from tasks.selection.model.features import Contender, Scanned


@dataclasses.dataclass(frozen=True)
class AlignedCandidate:
    """A candidate of an example: whose cloud, its box [m], and how it stands; see `Contender`."""

    asset_id: str
    extents: Array
    pose: NDArray[np.float64]
    scale: NDArray[np.float64]
    evidence: Array


@dataclasses.dataclass(frozen=True)
class Example:
    """An object of a training set.

    rankings: Of each annotator the places of candidates, best first.
    """

    scene_id: str
    room_id: str
    instance_id: str
    scanned: Scanned
    candidates: tuple[AlignedCandidate, ...]
    rankings: tuple[tuple[int, ...], ...]

    @property
    def choice(self) -> int:
        """The candidate that most annotators put first; of equals that of the first annotator."""
        return Counter(ranking[0] for ranking in self.rankings).most_common(1)[0][0]

    def contenders(self, clouds: Mapping[str, bytes]) -> list[Contender]:
        """Candidates with their clouds, of packed ones by asset."""
        return [Contender(unpacked(clouds[c.asset_id]), c.extents, c.pose, c.scale, c.evidence) for c in self.candidates]


def by_room(examples: Sequence[Example], share: float) -> tuple[list[Example], list[Example]]:
    """Examples to learn from, and those of a share of the rooms, drawn by the rooms' names, to choose the best weights by.

    At least one room is held out where there are two.
    """
    rooms = sorted({example.room_id for example in examples}, key=lambda room: hashlib.sha256(f"validation {room}".encode()).digest())
    held = set(rooms[: max(round(share * len(rooms)), 1)]) if share > 0 and len(rooms) > 1 else set()
    return [e for e in examples if e.room_id not in held], [e for e in examples if e.room_id in held]
