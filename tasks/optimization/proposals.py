"""Which asset stands for every instance, and where: the winning annotation, else the selection's first."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.annotation import Annotation
from schemas.capture import Instance
from schemas.selection import Selection
from tasks.annotation.agreement import winning
from tasks.geometry.boxes import oriented_iou
from tasks.geometry.transforms import matrix

MATCH_IOU = 0.5
"""An annotation's box is an instance's box when they share half of what they cover together: two objects cannot both."""

SAME_BOX = 1e-6
"""Boxes that differ by less [m] are one box, written twice."""


@dataclasses.dataclass(frozen=True)
class Proposal:
    """An asset for an instance. `pose`: asset to world frame, 4x4 [m]; `scale`: along the asset's own axes, shape (3,)."""

    instance: Instance
    asset_id: str
    pose: NDArray[np.float64]
    scale: NDArray[np.float64]
    origin: str
    annotator: str | None = None
    annotation_match: str | None = None


def propose(
    instances: Sequence[Instance], selections: Sequence[Selection], annotations: Sequence[Annotation], assets: Collection[str]
) -> tuple[list[Proposal], list[str]]:
    """A proposal for every instance that has one, sorted by instance, and what has to be said about the others."""
    objects = sorted((i for i in instances if not i.is_structure), key=lambda i: i.instance_id)
    ranked: dict[str, list[Selection]] = defaultdict(list)
    for row in sorted(selections, key=lambda s: (s.instance_id, s.rank)):
        if row.asset_id in assets:
            ranked[row.instance_id].append(row)
    matched, how, notes = match_annotations(annotations, objects)
    answers = winning(matched)
    proposals = []
    for instance in objects:
        choices, answer = ranked[instance.instance_id], answers.get(instance.instance_id)
        proposal = None
        if answer is not None:
            proposal, problem = _annotated(instance, answer, how[_key(answer)], choices, assets)
            notes += [problem] if problem else []
        if proposal is None and choices:
            first = choices[0]
            proposal = Proposal(instance, first.asset_id, matrix(first.pose), np.array(first.scale), "selection")
        if proposal is None:
            notes.append(f"{instance.instance_id}: nothing stands for this {instance.category}: no candidate could be used")
        else:
            proposals.append(proposal)
    return proposals, notes


def match_annotations(
    annotations: Sequence[Annotation], instances: Sequence[Instance]
) -> tuple[list[Annotation], Mapping[tuple[str, str, str], str], list[str]]:
    """Annotations with the id of the instance that they are for now, how each was matched, and the orphaned ones.

    Instances are numbered anew when a scan is captured again. An annotation belongs to the instance whose box is its
    box, else to the one whose box shares most with it, at least `MATCH_IOU`; otherwise it is orphaned. How an
    annotation was matched is keyed by batch, annotator and the instance that it is for now.
    """
    matched: list[Annotation] = []
    how: dict[tuple[str, str, str], str] = {}
    orphans: list[str] = []
    by_id = {i.instance_id: i for i in instances}
    for row in sorted(annotations, key=lambda a: (a.instance_id, a.annotator, a.batch_id)):
        same = by_id.get(row.instance_id)
        if same is not None and _is_same_box(row, same):
            match, kind = same, "same_box"
        else:
            shares = [(oriented_iou(row.box_pose, row.box_size, i.box_pose, i.box_size), i) for i in instances]
            share, best = max(shares, key=lambda s: (s[0], s[1].instance_id), default=(0.0, None))
            if best is None or share < MATCH_IOU:
                whose = f"{row.instance_id}: annotation by {row.annotator} in batch {row.batch_id}"
                orphans.append(f"{whose} is orphaned: no instance has its box; annotate again")
                continue
            match, kind = best, "same_box" if _is_same_box(row, best) else "box_iou"
        moved = dataclasses.replace(row, instance_id=match.instance_id)
        if _key(moved) not in how:
            how[_key(moved)] = kind
            matched.append(moved)
    return matched, how, orphans


def _key(row: Annotation) -> tuple[str, str, str]:
    return row.batch_id, row.annotator, row.instance_id


def _is_same_box(row: Annotation, instance: Instance) -> bool:
    return bool(
        np.allclose(row.box_pose, instance.box_pose, rtol=0, atol=SAME_BOX)
        and np.allclose(row.box_size, instance.box_size, rtol=0, atol=SAME_BOX)
    )


def _annotated(
    instance: Instance, answer: Annotation, match: str, choices: Sequence[Selection], assets: Collection[str]
) -> tuple[Proposal | None, str | None]:
    """The proposal that an answer makes, or why it makes none."""
    name, who = instance.instance_id, f"annotators ({answer.annotator}, batch {answer.batch_id})"
    if answer.choice is None:
        return None, f"{name}: {who} found that no candidate fits; the selection's first stands in"
    aligned = next((row for row in choices if row.asset_id == answer.choice), None)
    if answer.choice not in assets or (answer.pose is None and aligned is None):
        return None, f"{name}: asset {answer.choice[:12]} chosen by {who} is no candidate any more; the selection's first stands in"
    pose = answer.pose or (aligned.pose if aligned else ())
    scale = answer.scale or (aligned.scale if aligned else (1.0, 1.0, 1.0))
    return Proposal(instance, answer.choice, matrix(pose), np.array(scale), "annotation", answer.annotator, match), None
