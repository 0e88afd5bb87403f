"""Which instances of a scene look alike, so that what is made for the one that was seen best is offered to the others, too.

The chairs round a table are one model; scans show each of them in part. Whether an asset does for several is for the selection to say.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from schemas.captions import Caption
from schemas.capture import Instance
from tasks.geometry.boxes import grown_box

ALIKE = 0.1
"""Sides of boxes that differ by less than this share are the same side of one model, scanned twice."""


def exemplars(instances: Sequence[Instance], captions: Mapping[str, Caption]) -> dict[str, str]:
    """For every instance that looks like others, itself included, the one that stands for that look: of one category, in one color.

    Two sides of the boxes with what is hidden are the same, and the third is, or is shorter, as where a scan saw a part. The exemplar is
    the one that most others have all sides in common with, then the largest, then the first.
    """
    by_kind: dict[tuple[str, str | None], list[Instance]] = {}
    for row in sorted(instances, key=lambda row: row.instance_id):
        if row.category and not row.is_structure:
            caption = captions.get(row.instance_id)
            by_kind.setdefault((row.category, caption.colors[0] if caption and caption.colors else None), []).append(row)
    known: dict[str, str] = {}
    for rows in by_kind.values():
        sizes = {row.instance_id: np.sort(grown_box(row.box_pose, row.box_size, row.hidden_m)[1]) for row in rows}
        counts = Counter(a for a in sizes for b in sizes if a != b and _sides(sizes[a], sizes[b]).all())
        ranked = sorted(sizes, key=lambda name: (-counts[name], -float(np.prod(sizes[name])), name))
        for name in ranked:
            if name in known:
                continue
            alike = [other for other in ranked if other != name and other not in known and _is_part_of(sizes[other], sizes[name])]
            if alike:
                known |= dict.fromkeys([name, *alike], name)
    return known


def _sides(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Which sides of two boxes are the same, shape (3,) each [m]."""
    return np.asarray(np.abs(a - b) <= ALIKE * np.maximum(np.maximum(a, b), 1e-6))


def _is_part_of(part: np.ndarray, whole: np.ndarray) -> bool:
    """Whether a box is that of a whole, or of a part of it that lacks some of one side; sorted sides, shape (3,) each [m]."""
    if _sides(part, whole).all():
        return True
    # a side that was seen in part may have become the shortest
    for lost in range(3):
        rest = np.sort(np.delete(whole, lost))
        for own in range(3):
            if part[own] < whole[lost] and _sides(np.sort(np.delete(part, own)), rest).all():
                return True
    return False
