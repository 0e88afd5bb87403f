"""What the page asks while somebody places an asset: the figures of the guidelines, and the optimizer's word on that one object."""

from __future__ import annotations

import contextlib
import dataclasses
import threading
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import numpy as np

from flows.inputs.annotation.acts import now, rows_of
from flows.inputs.annotation.listing import plain
from flows.run.configuration import configure
from flows.run.fingerprints import ModuleCaches
from flows.view.annotating.drafts import Key
from flows.view.annotating.requests import ANSWERED, Refusal, read_draft, refusing
from flows.view.annotating.work import ServedBatch, transform_document
from schemas.annotation import Annotation
from schemas.candidates import Asset, Candidate
from schemas.capture import Instance, Shell
from schemas.errors import LakeError
from schemas.selection import Selection
from tasks.annotation import STAGE
from tasks.annotation.guidelines import figures, furnished
from tasks.annotation.revisions import latest
from tasks.geometry.transforms import flat, translation
from tasks.optimization.default import Default
from tasks.optimization.interior import Interior
from tasks.optimization.single import rest_alone
from tasks.optimization.support.supports import SupportConfig
from tasks.stage import Context

KEPT = 8
"""Rooms whose rows are kept at hand."""


@dataclasses.dataclass(frozen=True)
class RoomRows:
    """The rows of a scene that an answer is held against."""

    instances: tuple[Instance, ...]
    candidates: tuple[Candidate, ...]
    selections: tuple[Selection, ...]
    shells: tuple[Shell, ...]
    assets: tuple[Asset, ...]


class Rooms:
    """The rooms of a batch, as each of its annotators has furnished them so far. Nothing here changes the lake."""

    def __init__(self, work: ServedBatch) -> None:
        self._work, self._lock = work, threading.Lock()
        self._kept = OrderedDict[str, RoomRows]()
        self._caches = ModuleCaches()
        self._reader = work.scenes.reader

    def figures(self, name: str, key: Key, body: Mapping[str, Any]) -> dict[str, Any] | None:
        """What the guidelines say of what somebody sets for an object; None where nothing is chosen or it cannot be placed.

        Raises:
            Refusal: it could not be saved as an answer.
        """
        return self._figures(name, self._answer(name, key, body))

    def settled(self, name: str, key: Key, body: Mapping[str, Any]) -> dict[str, Any]:
        """Where the optimizer puts what somebody chose, all other objects held where they are.

        Raises:
            Refusal: it could not be saved as an answer, nothing is chosen, or it cannot be placed.
        """
        answer = self._answer(name, key, body)
        if answer.choice is None:
            raise Refusal(400, "choice: nothing is chosen that could be put to rest")
        interior = self._furnished(answer)
        places = {row: index for index, row in enumerate(interior.names)}
        index = places.get(answer.instance_id)
        if index is None or interior.proposals[index].asset_id != answer.choice:
            raise Refusal(400, "transform: is missing, and selection could not align this candidate; or its mesh cannot be placed")
        rested = rest_alone(interior, answer.instance_id, Default(), SupportConfig(), self._context(answer.scene_id).rng)
        scale = tuple(float(value) for value in interior.proposals[index].scale)
        answer = dataclasses.replace(answer, pose=flat(rested.pose), scale=scale)
        return {
            "transform": transform_document(flat(rested.pose), scale),
            "moved_m": float(np.linalg.norm(rested.pose[:3, 3] - interior.poses[index][:3, 3])),
            "steps": list(dict.fromkeys(rested.outcomes)),
            "problem": rested.problem,
            "figures": self._figures(name, answer),
        }

    def warm(self, ending: threading.Event) -> None:
        """Load what settling needs, so that nobody waits for machine code to be made: every object of a room put to rest, as it is and
        pushed into its neighbor. Stops between two objects once `ending` is set."""
        scenes = sorted(self._work.scenes.scene_ids)
        for scene in scenes[:KEPT]:
            with contextlib.suppress(LakeError):  # whoever asks for the room hears it
                interior = self._interior(scene, {})
                names = interior.names if scene == scenes[0] else []
                for index, row in enumerate(names):
                    if ending.is_set():
                        return
                    poses = interior.poses.copy()
                    for shift in (0.0, 0.1):
                        poses[index] = translation((shift, shift, -shift)) @ poses[index]
                        pushed = dataclasses.replace(interior, poses=poses)
                        rest_alone(pushed, row, Default(), SupportConfig(), self._context(scene).rng)

    def _rows(self, scene_id: str) -> RoomRows:
        reader = self._work.scenes.reader
        with self._lock:
            if reader is not self._reader:  # of a snapshot that was written again: a scene was erased
                self._kept.clear()
                self._reader, self._caches = reader, ModuleCaches()
            if scene_id not in self._kept:
                candidates, selections = reader.rows(Candidate, scene_id), reader.rows(Selection, scene_id)
                named = {row.asset_id for row in selections} | {row.asset_id for row in candidates if row.asset_id is not None}
                assets = reader.rows_by_key(Asset, named)
                instances, shells = reader.rows(Instance, scene_id), reader.rows(Shell, scene_id)
                self._kept[scene_id] = RoomRows(tuple(instances), tuple(candidates), tuple(selections), tuple(shells), tuple(assets))
                if len(self._kept) > KEPT:
                    self._kept.popitem(last=False)
            self._kept.move_to_end(scene_id)
            return self._kept[scene_id]

    def _answer(self, name: str, key: Key, body: Mapping[str, Any]) -> Annotation:
        """What somebody sets for an object as a row, held against the scene as an answer is when it is saved."""
        batch, rows = read_draft(self._work, name, key, body, now().isoformat()), self._rows(key[0])
        with refusing():
            (row,) = STAGE.run(
                annotation_batch=batch, review_batch=None, batch_acts=None, instances=rows.instances, candidates=rows.candidates,
                context=self._context(key[0]), config=configure().stages[STAGE.name],
            ).rows["annotations"]  # fmt: skip
        assert isinstance(row, Annotation)
        return row

    def _around(self, answer: Annotation) -> dict[str, Annotation]:
        """What else its annotator has put into the room of an answer, by instance: drafts, and answers where there is none."""
        rows = rows_of(self._work.lake.snapshot(), Annotation, self._work.batch_id)
        own = {
            row.instance_id: row for row in latest(rows).values() if row.annotator == answer.annotator and row.scene_id == answer.scene_id
        }
        for key, draft in self._work.drafts.of(answer.annotator).items():
            if key[0] == answer.scene_id and draft.body is not None:
                with contextlib.suppress(Refusal):  # half an answer puts nothing there yet
                    own[key[1]] = self._answer(answer.annotator, key, {name: draft.body[name] for name in ANSWERED if name in draft.body})
        own.pop(answer.instance_id, None)
        return own

    def _furnished(self, answer: Annotation) -> Interior:
        return self._interior(answer.scene_id, self._around(answer) | {answer.instance_id: answer})

    def _interior(self, scene_id: str, own: Mapping[str, Annotation]) -> Interior:
        rows = self._rows(scene_id)
        blobs = self._work.lake.blobs
        return furnished(own, rows.instances, rows.selections, rows.shells, rows.assets, blobs, self._caches)

    def _figures(self, name: str, answer: Annotation) -> dict[str, Any] | None:
        if answer.choice is None:
            return None
        rows, around = self._rows(answer.scene_id), list(self._around(answer).values())
        blobs = self._work.lake.blobs
        made = figures([answer], rows.instances, rows.selections, rows.shells, rows.assets, blobs, self._caches, around)
        return plain(made[0]) if made else None

    def _context(self, scene_id: str) -> Context:
        return Context(scene_id=scene_id, stage="optimization", seed=0, blobs={})
