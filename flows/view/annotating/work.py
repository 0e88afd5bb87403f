"""What a person has before them: the objects that are asked of an annotator, the answers that a reviewer judges, how the batch stands."""

from __future__ import annotations

import threading
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from flows.inputs.annotation import batch_list, open_reviews, open_work
from flows.inputs.annotation.acts import known_state, rows_of, state_in
from flows.inputs.annotation.creation import asked_of
from flows.view.annotating.drafts import Drafts, KeptDraft, Key
from flows.view.annotating.people import roles_of
from flows.view.annotating.photos import Photo, photos_of
from flows.view.frames import picture
from flows.view.scene import Document, Scenes, Shown
from schemas.annotation import Assignment, WorkBatch
from schemas.capture import Frame
from schemas.errors import InputError
from tasks.annotation.quality import pass_interval
from tasks.geometry.transforms import matrix, quaternion_wxyz
from warehouse.lake import Lake
from warehouse.tables.gate import demands
from warehouse.tables.snapshot import Reader

COMPARED = ("instances", "candidates", "selections")
"""Tables of what people are shown of an object: no answer is saved once its rows there are others."""


class BatchScenes(Scenes):
    """The scenes of a batch; others are not there."""

    def __init__(self, lake: Lake, snapshot_id: int, scene_ids: Sequence[str], blobs: frozenset[str]) -> None:
        """`blobs`: what may be asked for before a scene was shown."""
        super().__init__(lake, snapshot_id)
        self._is_chosen = False  # each answer is a commit: once this snapshot is gone, the last one is shown
        self.keep(scene_ids, blobs)

    def keep(self, scene_ids: Collection[str], blobs: frozenset[str]) -> None:
        """Show these scenes and offer these blobs, and no others."""
        self.scene_ids, self._offered = frozenset(scene_ids), blobs

    def listed(self) -> Document:
        """See Scenes."""
        document = super().listed()
        return document | {"scenes": [row for row in document["scenes"] if row["id"] in self.scene_ids]}

    def first(self) -> str:
        """See Scenes."""
        if not self.scene_ids:
            raise InputError(self.lake.address, "scenes", "the scenes of this batch were erased")
        return min(self.scene_ids)

    def shown(self, scene_id: str) -> Shown:
        """See Scenes."""
        self._refuse_strange(scene_id)
        return super().shown(scene_id)

    def scan_path(self, scene_id: str) -> str:
        """See Scenes."""
        self._refuse_strange(scene_id)
        return super().scan_path(scene_id)

    def frame(self, scene_id: str, frame_id: str) -> Frame:
        """See Scenes."""
        self._refuse_strange(scene_id)
        return super().frame(scene_id, frame_id)

    def blob(self, name: str) -> bytes:
        """See Scenes."""
        return self.lake.blobs[name] if name in self._offered else super().blob(name)

    def _refuse_strange(self, scene_id: str) -> None:
        if scene_id not in self.scene_ids:
            raise InputError(self.lake.address, scene_id, "is no scene of this batch")


class ServedBatch:
    """A batch as its people see it. Objects and candidates are those of the snapshot that the server began with."""

    def __init__(self, lake: Lake, batch_id: str, drafts: Drafts, reviewers: Sequence[str]) -> None:
        """Raises InputError: the lake has no such batch, it was made elsewhere, or its objects are not there any more."""
        commit, reader = lake.last_commit(), lake.snapshot()
        batch = created_batch(reader, batch_id)
        self.lake, self.batch_id, self.drafts = lake, batch_id, drafts
        assignments = rows_of(reader, Assignment, batch_id)
        self.roles = roles_of({row.annotator for row in assignments}, reviewers)
        self.assigned: dict[Key, frozenset[str]] = {}
        for row in assignments:
            key = (row.scene_id, row.instance_id)
            self.assigned[key] = self.assigned.get(key, frozenset()) | {row.annotator}
        asked = asked_of(reader, batch, assignments)
        self.assets = {row.asset_id: row for row in asked.assets}
        self.scenes = BatchScenes(lake, reader.snapshot_id, sorted({scene for scene, _ in self.assigned}), frozenset())
        self._shown_files = {table: reader.files(table) for table in COMPARED}
        only = {"scene_id": {scene for scene, _ in self.assigned}}
        self._shown_rows = {table: reader.matching(table, only) for table in COMPARED}
        self._photos = photos_of(self.scenes, asked.instances)
        self._other_photos: dict[tuple[Key, str], Photo] = {
            (key, photo.frame.frame_id): photo for key, photos in self._photos.items() for photo in photos if not photo.is_best
        }
        self._instances = asked.instances
        self._objects = {(row["scene_id"], row["instance_id"]): self._object(row) for row in asked.document["objects"]}
        self._rooms: list[dict[str, Any]] = asked.document["scenes"]
        self._thumbnails: dict[str, bytes] = {}
        self._drawing, self._looking = threading.Lock(), threading.Lock()
        self._keep(frozenset(self._objects))
        self._commit = commit

    def _object(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """What everybody is shown of an object."""
        scene, instance = row["scene_id"], row["instance_id"]
        best = _address("photos", row["view"])
        photos = [
            {"photo": best if photo.is_best else f"/api/photos/{scene}/{instance}/{photo.frame.frame_id}", "camera": photo.camera}
            for photo in self._photos.get((scene, instance), ())
        ]
        return {
            "key": f"{scene}/{instance}", "scene_id": scene, "instance_id": instance, "category": row["category"],
            "caption": row["caption"], "box": row["box"], "points": _address("points", row["points"]),
            "photo": best, "photos": photos,
            "candidates": [
                dict(offer) | {
                    "glb": f"/blobs/{self.assets[offer['asset_id']].mesh_blob}", "thumbnail": f"/thumbnails/{offer['asset_id']}.jpg",
                }
                for offer in row["candidates"]
            ],
        }  # fmt: skip

    def refresh(self) -> None:
        """Forget the scenes that were erased since the last look: their objects, images, files and drafts."""
        with self._looking:
            self.scenes.refresh()
            commit = self.scenes.commit
            if commit == self._commit:
                return
            rows = rows_of(self.lake.snapshot(), Assignment, self.batch_id)
            kept = frozenset((row.scene_id, row.instance_id) for row in rows) & self._objects.keys()
            if kept != self._objects.keys():
                # First, since an error here is met again by the next request. The file may lie where the erasure did not look.
                self.drafts.remove_scenes({scene for scene, _ in self._objects} - {scene for scene, _ in kept})
                self._keep(kept)
            self._commit = commit

    def _keep(self, keys: frozenset[Key]) -> None:
        """Keep these objects and all that is shown of them, and nothing else."""
        scenes = {scene for scene, _ in keys}
        self._objects = {key: value for key, value in self._objects.items() if key in keys}
        self._rooms = [row for row in self._rooms if row["scene_id"] in scenes]
        self._instances = tuple(row for row in self._instances if (row.scene_id, row.instance_id) in keys)
        self.points = frozenset(row.points_blob for row in self._instances)
        self.photos = frozenset(row.view_blob for row in self._instances if row.view_blob is not None)
        self._other_photos = {name: photo for name, photo in self._other_photos.items() if name[0] in keys}
        in_scenes = pa.array(sorted(scenes), pa.string())
        self._shown_rows = {
            table: rows.filter(pc.is_in(rows.column("scene_id"), value_set=in_scenes)) for table, rows in self._shown_rows.items()
        }
        offered = {offer["asset_id"] for row in self._objects.values() for offer in row["candidates"]}
        with self._drawing:
            self.assets = {name: asset for name, asset in self.assets.items() if name in offered}
            self._thumbnails = {name: data for name, data in self._thumbnails.items() if name.removesuffix(".jpg") in offered}
        self.scenes.keep(scenes, frozenset(row.mesh_blob for row in self.assets.values()))

    def is_asked(self, key: Key) -> bool:
        """True while the lake asks for an object, which ends when its scene is erased."""
        return key in self._objects

    def is_as_shown(self, reader: Reader, key: Key) -> bool:
        """True if a snapshot has an object, its candidates and their selection as people are shown them."""
        only = {"scene_id": [key[0]], "instance_id": [key[1]]}
        return all(
            self._shown_files[table] == reader.files(table) or self._shown(table, key).equals(reader.matching(table, only))
            for table in COMPARED
        )

    def _shown(self, table: str, key: Key) -> pa.Table:
        """Rows of an object as people are shown them."""
        rows = self._shown_rows[table]
        is_of = pc.and_(pc.equal(rows.column("scene_id"), key[0]), pc.equal(rows.column("instance_id"), key[1]))
        return rows.filter(is_of)

    def by_asset(self, key: Key, values: Mapping[str, Any]) -> dict[str, Any]:
        """What somebody sets for an object, candidates by asset: another snapshot may have others in the slots that are shown."""
        assets = {offer["slot"]: offer["asset_id"] for offer in self._objects[key]["candidates"]}
        named = {"choice": assets.get(values["choice"], values["choice"])} if "choice" in values else {}
        ranking = {"ranking": list(dict.fromkeys(assets.get(each, each) for each in values["ranking"]))} if values.get("ranking") else {}
        return {**values, **named, **ranking}

    def me(self, name: str) -> dict[str, Any]:
        """Who somebody is, and how the batch stands."""
        (row,) = batch_list(self.lake, self.batch_id)
        share, least, pass_share = demands(known_state(self.lake.snapshot(), self.batch_id).batch)
        return {
            "person": name,
            "roles": list(self.roles[name]),
            "batch": {key: row[key] for key in ("batch_id", "state", "round", "origin", "next", "counts")},
            "tool": "metascenes",
            "settings": {"least_sample": least, "pass_share": pass_share, "sample_share": share},
        }

    def objects(self, name: str) -> dict[str, Any]:
        """What is asked of an annotator, in the order of their list, with what they answered and began."""
        drafts, rows = self.drafts.of(name), open_work(self.lake, self.batch_id, name)
        objects = []
        for row in rows:
            key = (row["scene_id"], row["instance_id"])
            draft = drafts.get(key)
            status = "draft" if draft else "answered" if row["is_answered"] else "withdrawn" if row["is_withdrawn"] else "open"
            objects.append(
                self._objects[key]
                | {name: row[name] for name in ("place", "reasons", "doubt", "is_open", "remarks", "figures")}
                | {"status": status, "answer": _answer(row["answer"]), "draft": draft_document(draft)}
            )
        scenes = {row["scene_id"] for row in rows}
        return {"objects": objects, "scenes": [row for row in self._rooms if row["scene_id"] in scenes]}

    def reviews(self, name: str) -> dict[str, Any]:
        """The sampled answers that a reviewer judges, in the order in which they were drawn; never their own."""
        rows = open_reviews(self.lake, self.batch_id, name)
        answers = [
            self._objects[row["scene_id"], row["instance_id"]]
            | {name: row[name] for name in ("annotator", "place", "is_open", "figures")}
            | {
                "answer": _answer(row["answer"]),
                "verdict": None if row["verdict"] is None else {key: row["verdict"][key] for key in ("passes", "remark", "reviewer")},
            }
            for row in rows
        ]
        scenes = {row["scene_id"] for row in answers}
        return {"answers": answers, "scenes": [row for row in self._rooms if row["scene_id"] in scenes]}

    def progress(self) -> dict[str, Any]:
        """How the batch stands, how far everybody is, and what the sample says so far."""
        (row,) = batch_list(self.lake, self.batch_id)
        state, drafts = state_in(self.lake.snapshot(), self.batch_id), self.drafts.count()
        judged = len(state.verdicts)
        low, high = pass_interval(state.passed, judged, len(state.handed_in)) if judged else (None, None)
        people = [{"person": name, **count, "drafts": drafts.get(name, 0)} for name, count in row["by_annotator"].items()]
        reviews = {"sampled": len(state.sample), "judged": judged, "passed": state.passed, "pass_low": low, "pass_high": high}
        return {"batch": row, "people": people, "reviews": reviews}

    def thumbnail(self, name: str) -> bytes:
        """JPEG of a candidate; `name` is `<asset id>.jpg`.

        Raises:
            KeyError: the batch offers no such asset.
        """
        from tasks.geometry.meshes import load_glb
        from tasks.stats.thumbnails import object_thumbnail

        with self._drawing:  # each is drawn once, and drawing is not safe for several threads
            asset = self.assets[name.removesuffix(".jpg")] if name.endswith(".jpg") else self.assets[""]
            if name not in self._thumbnails:
                self._thumbnails[name] = object_thumbnail(load_glb(self.lake.blobs[asset.mesh_blob], f"{asset.name}.glb"))
            return self._thumbnails[name]

    def photo(self, key: Key, frame_id: str) -> bytes:
        """JPEG of an object in a frame other than that of its best view.

        Raises:
            KeyError: the batch shows no such photo.
            InputError: the scan's folder, or the picture in it, is not there any more.
        """
        photo = self._other_photos[key, frame_id]
        return picture(self.scenes.scan_path(key[0]), photo.frame, photo.window)

    def crop(self, name: str, among: frozenset[str]) -> bytes:
        """What the scan has of an object: points or photo, by the name of its blob.

        Raises:
            KeyError: it is not among those that the batch shows, or not there.
        """
        if name not in among:
            raise KeyError(name)
        return self.lake.blobs[name]


def created_batch(reader: Reader, batch_id: str) -> WorkBatch:
    """The row of a batch that can be served.

    Raises:
        InputError: the lake has no such batch, or it was made elsewhere.
    """
    state = known_state(reader, batch_id)
    if state.batch is None or state.origin != "created":
        raise InputError(batch_id, "BATCH", "was made elsewhere", "`metascenes annotate create` makes batches that can be served")
    return state.batch


def draft_document(draft: KeptDraft | None) -> dict[str, Any] | None:
    """A draft as its page gets it back."""
    if draft is None or draft.body is None:
        return None
    return {**draft.body, "edit": draft.edit, "page": draft.page, "saved_at": draft.saved_at}


def transform_document(pose: Sequence[float], scale: Sequence[float]) -> dict[str, Any]:
    """A pose, 4x4 row by row [m], and a scale in the words of `batch.schema.json`."""
    placed = matrix(pose)
    return {"position": placed[:3, 3].tolist(), "rotation_wxyz": list(quaternion_wxyz(placed)), "scale": list(scale)}


def _answer(row: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """An answer of the lake in the words of `batch.schema.json`."""
    if row is None:
        return None
    transform = None if row["pose"] is None else transform_document(row["pose"], row["scale"])
    return {name: row[name] for name in ("choice", "ranking", "seconds", "revision", "answered_at")} | {"transform": transform}


def _address(folder: str, file: str | None) -> str | None:
    """Where a file of the document of a batch is served."""
    return None if file is None else f"/{folder}/{file.rpartition('/')[2]}"
