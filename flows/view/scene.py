"""What the page is told of a scene, from the rows and blobs of one snapshot."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import threading
from collections import Counter, OrderedDict
from typing import Any

from flows.view.drives import drives_of
from flows.view.frames import AWAY, are_at_hand
from flows.view.objects import ObjectRows, blobs_of, objects_of
from flows.view.shapes import colliders_of, navmesh_triangles, shell_glb
from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Frame, Instance, Mask, RoomSurface, Scene, Shell
from schemas.errors import InputError
from schemas.exports import ExportFile
from schemas.fidelity import Fidelity, SceneFidelity
from schemas.navigation import Episode, Navmesh
from schemas.optimization import Certificate, Contact, Optimization, Placement, Support
from schemas.selection import Selection
from schemas.wording import counted, meant, noun
from warehouse.lake import Lake

Document = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Shown:
    """A scene as it is shown: what the page is told of it, the bytes that were made for it by name, and the blobs that it may ask for."""

    document: Document
    made: dict[str, bytes]
    blobs: frozenset[str]


class Scenes:
    """The scenes of one snapshot. What was made for a page is kept while it is among the last few."""

    def __init__(self, lake: Lake, snapshot_id: int | None = None, release: str | None = None, kept: int = 8) -> None:
        """`release`: what the snapshot is called. Without `snapshot_id` the last one, and a later one once that is gone."""
        self.lake, self._is_chosen = lake, snapshot_id is not None
        self.commit = lake.last_commit()
        self.reader = lake.snapshot(snapshot_id)
        if self.reader.snapshot is None:
            raise InputError(lake.address, "view", "the lake has no snapshot yet", "run something first")
        self.release = release
        self._kept, self._most, self._lock = OrderedDict[str, Shown](), kept, threading.Lock()
        self._looking = threading.Lock()
        self._namers: dict[str, set[str]] = {}  # scenes that were shown, by name of a blob or of bytes that were made
        self._blobs: set[str] = set()

    def refresh(self) -> None:
        """Forget all that is kept in memory if the snapshot was written again, which is how an erasure takes a scene away.

        As long as nobody commits this takes one listing of the log of snapshots.

        Raises:
            InputError: the snapshot that was asked for is gone.
        """
        with self._looking:
            commit = self.lake.last_commit()
            if commit == self.commit:
                return
            newest = self.lake.snapshot()
            row = next((row for row in newest.snapshots if row.snapshot_id == self.reader.snapshot_id), None)
            if row is None or row != self.reader.snapshot:
                is_moved = row is None and not self._is_chosen
                reader = newest if is_moved else self.lake.snapshot(self.reader.snapshot_id)
                known = set(reader.matching("scenes", {}, ["scene_id"]).column("scene_id").to_pylist())
                with self._lock:  # a scene that is being read from the old files is forgotten as well
                    self.reader = reader
                    self._kept.clear()
                    self._blobs.clear()
                    self._namers = {name: scenes & known for name, scenes in self._namers.items() if scenes & known}
            self.commit = commit

    def listed(self) -> Document:
        """All scenes in short, and which snapshot this is."""
        count = {row["scene_id"]: row for row in self.reader.matching("optimizations", {}, ["object_count", "deep_pairs"]).to_pylist()}
        rooms = {row["scene_id"]: row for row in self.reader.matching("shells", {}, ["room_type", "floor_area_m2"]).to_pylist()}
        rows = self.reader.matching("scenes", {}, ["instance_count"]).to_pylist()
        unstable: dict[str, int] = {}
        for row in self.reader.matching("certificates", {"engine": ["mujoco"], "is_stable_1cm": [False]}, ["engine"]).to_pylist():
            unstable[row["scene_id"]] = unstable.get(row["scene_id"], 0) + 1
        scenes = [
            {
                "id": row["scene_id"],
                "room": rooms.get(row["scene_id"], {}).get("room_type", "unknown"),
                "area": rooms.get(row["scene_id"], {}).get("floor_area_m2"),
                "placed": count.get(row["scene_id"], {}).get("object_count"),
                "deep": count.get(row["scene_id"], {}).get("deep_pairs"),
                "unstable": unstable.get(row["scene_id"], 0),
            }
            for row in rows
        ]
        return {"lake": self.lake.address, "snapshot": self.reader.snapshot_id, "release": self.release, "scenes": scenes}

    def first(self) -> str:
        """The scene that is shown when none is asked for.

        Raises:
            InputError: there is no scene.
        """
        rows = self.reader.matching("scenes", {}, ["dataset"]).column("scene_id").to_pylist()
        if not rows:
            raise InputError(self.lake.address, "scenes", "the lake has no scene", "see `metascenes status`")
        return str(rows[0])

    def place(self, address: str) -> tuple[str, str | None]:
        """The scene and the object that an address (`dataset/scan`, `dataset/scan/0007`) names; None for a scene alone.

        Raises:
            InputError: either is not in the snapshot.
        """
        parts = address.split("/")
        scene_id, instance_id = "/".join(parts[:2]), "/".join(parts[2:])
        self.scan_path(scene_id)
        if len(parts) < 3:
            return scene_id, None
        if not any(row.instance_id == instance_id and not row.is_structure for row in self.reader.rows(Instance, scene_id)):
            raise InputError(self.lake.address, address, "there is no such object", f"see `metascenes explain {scene_id}`")
        return scene_id, instance_id

    def _unknown(self, scene_id: str) -> InputError:
        known = self.reader.matching("scenes", {}, ["scene_id"]).column("scene_id").to_pylist()
        return InputError(self.lake.address, scene_id, "there is no such scene", f"{meant(scene_id, known)}see `metascenes scenes`")

    def shown(self, scene_id: str) -> Shown:
        """A scene as it is shown.

        Raises:
            InputError: it is not in the snapshot.
        """
        with self._lock:  # made once, however many pages ask
            if scene_id not in self._kept:
                self._kept[scene_id] = shown = self._show(scene_id)
                if len(self._kept) > self._most:
                    self._kept.popitem(last=False)
                for name in (*shown.made, *shown.blobs):
                    self._namers.setdefault(name, set()).add(scene_id)
                self._blobs |= shown.blobs
            self._kept.move_to_end(scene_id)
            return self._kept[scene_id]

    def blob(self, name: str) -> bytes:
        """Bytes that a scene that was shown names: a blob of the snapshot, or what was made for the page, made again if need be.

        Raises:
            KeyError: no such scene names it, or it is not there.
        """
        if name in self._blobs:
            return self.lake.blobs[name]
        for scene_id in sorted(self._namers.get(name, ())):
            shown = self.shown(scene_id)
            if name in shown.made:
                return shown.made[name]
            if name in shown.blobs:
                return self.lake.blobs[name]
        raise KeyError(name)

    def _show(self, scene_id: str) -> Shown:
        read, made = self.reader, dict[str, bytes]()

        def kept(extension: str, data: bytes | None) -> str | None:
            if data is None:
                return None
            name = f"{hashlib.sha256(data).hexdigest()}.{extension}"
            made[name] = data
            return name

        scenes = read.rows(Scene, scene_id)
        if not scenes:
            raise self._unknown(scene_id)
        scene, shells = scenes[0], read.rows(Shell, scene_id)
        placements, candidates = read.rows(Placement, scene_id), read.rows(Candidate, scene_id)
        named = {row.asset_id for row in placements} | {row.asset_id for row in candidates if row.asset_id}
        assets = read.rows_by_key(Asset, sorted(named))
        objects = objects_of(
            ObjectRows(
                read.rows(Instance, scene_id), read.rows(Caption, scene_id), candidates, read.rows(Selection, scene_id), placements,
                read.rows(Support, scene_id), read.rows(Certificate, scene_id), read.rows(Fidelity, scene_id), assets,
                self._scan_licenses(assets, scene),
            ),
            colliders_of(read.rows(ExportFile, scene_id), self.lake.blobs),
        )  # fmt: skip
        surfaces = read.rows(RoomSurface, scene_id)
        document: Document = {
            "id": scene_id,
            "scan": scene.mesh_blob,
            "shell": kept("glb", shell_glb(shells, surfaces, self.lake.blobs)),
            "room": _room(shells[0]) if shells else None,
            "facts": _facts(scene, shells, read.rows(Optimization, scene_id), read.rows(SceneFidelity, scene_id)),
            "objects": objects,
            "contacts": [_contact(row) for row in read.rows(Contact, scene_id) if row.penetration_m > 0],
            "navmeshes": [
                {
                    "agent": row.agent, "radius": row.agent_radius_m, "height": row.agent_height_m, "area": row.area_m2,
                    "blob": kept("json", _compact(navmesh_triangles(self.lake.blobs[row.navmesh_blob]))),
                }
                for row in read.rows(Navmesh, scene_id)
            ],
            "episodes": [_episode(row) for row in read.rows(Episode, scene_id)],
            "drives": drives_of(read, scene_id),
            "frames": self._frames(scene),
        }  # fmt: skip
        return Shown(document, made, frozenset({scene.mesh_blob} | blobs_of(objects)))

    def _scan_licenses(self, assets: list[Asset], scene: Scene) -> dict[str, str | None]:
        """Licenses of the scans that assets were cut from: of this scene, and of others where an asset came from there."""
        sources = {asset.source for asset in assets} | {scene.scene_id}
        return {row.scene_id: row.license for row in self.reader.rows_by_key(Scene, sorted(sources))}

    def _frames(self, scene: Scene) -> Document:
        """Frames that show an instance best, with how many are marked in each, and why they cannot be shown where they cannot."""
        ids = self.reader.matching("masks", {"scene_id": [scene.scene_id]}, ["frame_id"]).column("frame_id").to_pylist()
        count = Counter(ids)
        rows = [row for row in self.reader.rows(Frame, scene.scene_id) if row.frame_id in count]
        excuse = "" if rows and are_at_hand(scene.scan_path, rows[0]) else AWAY if rows else "no frame of this scan is marked"
        return {"excuse": excuse, "rows": [{"id": row.frame_id, "masks": count[row.frame_id]} for row in rows]}

    def masks(self, scene_id: str, frame_id: str) -> Document:
        """What is marked in a frame.

        Raises:
            InputError: there is no such frame.
        """
        frame = self.frame(scene_id, frame_id)
        rows = [row for row in self.reader.rows(Mask, scene_id) if row.frame_id == frame_id]
        masks = [{"id": row.instance_id, "box": row.pixel_box, "runs": row.run_lengths} for row in rows]
        return {"id": frame_id, "width": frame.width, "height": frame.height, "masks": masks}

    def scan_path(self, scene_id: str) -> str:
        """Where the scan of a scene lay when it was captured.

        Raises:
            InputError: there is no such scene.
        """
        rows = self.reader.rows(Scene, scene_id)
        if not rows:
            raise self._unknown(scene_id)
        return rows[0].scan_path

    def frame(self, scene_id: str, frame_id: str) -> Frame:
        """The row of a frame.

        Raises:
            InputError: there is no such frame.
        """
        rows = [row for row in self.reader.rows(Frame, scene_id) if row.frame_id == frame_id]
        if not rows:
            raise InputError(self.lake.address, f"{scene_id} frame {frame_id}", "there is no such frame")
        return rows[0]


def _room(row: Shell) -> Document:
    """The room; its polygon as its walls are numbered."""
    from tasks.shell import floor_ring

    try:
        polygon = floor_ring(row).tolist()
    except InputError:  # it crosses itself: there are no walls
        polygon = list(row.floor_polygon)
    return {"polygon": polygon, "height": row.height_m, "walls": [wall[:4] for wall in row.walls], "type": row.room_type}


def _facts(scene: Scene, shells: list[Shell], optimizations: list[Optimization], fidelity: list[SceneFidelity]) -> list[list[str]]:
    facts = [["dataset", scene.dataset], ["format", scene.scan_format], ["license", scene.license or "not stated"]]
    facts += [
        [
            "scan",
            (
                f"{scene.vertex_count:,} {noun(scene.vertex_count, 'vertex', 'vertices')}, {scene.face_count:,} "
                f"{noun(scene.face_count, 'face')}, {scene.frame_count:,} {noun(scene.frame_count, 'frame')}"
            ),
        ]
    ]
    facts += [["room", f"{row.room_type}, {row.floor_area_m2:.1f} m², {row.height_m:.2f} m high"] for row in shells]
    for optimized in optimizations:
        facts.append(["objects", f"{optimized.object_count} placed, {optimized.fixed_count} fastened"])
        facts.append(["overlaps", f"{counted(optimized.deep_pairs, 'pair')} deeper than 2 mm"])
        facts.append(
            [
                "optimization",
                (
                    f"{optimized.method}, {optimized.moves:,} {noun(optimized.moves, 'move')}, "
                    f"loss {optimized.loss_start:.3f} to {optimized.loss_final:.3f}"
                ),
            ]
        )
    for row in fidelity:
        if row.object_f_5cm is not None:
            facts.append(["fidelity", f"F-score of objects {row.object_f_5cm:.3f} at 5 cm"])
    return facts


def _contact(row: Contact) -> Document:
    return {"phase": row.phase, "a": row.instance_a, "b": row.body_b, "depth": row.penetration_m, "allowed": row.is_allowed}


def _episode(row: Episode) -> Document:
    return {
        "id": row.episode_id, "agent": row.agent, "split": row.split, "target": row.instance_id, "category": row.category,
        "instruction": row.instruction, "start": row.start_position, "yaw": row.start_yaw_radians, "goal": row.goal_position,
        "geodesic": row.geodesic_m, "path": row.path, "actions": row.actions, "final": row.final_position,
    }  # fmt: skip


def _compact(value: Any) -> bytes:
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()
