"""What is done to a small lake: each an operation that can be given again after it was killed, and then does what is missing.

A place is a folder with `lake`, `backup`, `restored` and `batches` in it.
"""

from __future__ import annotations

import dataclasses
import json
import os
import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.samples import INSTANCES, fingerprint, stage_part

SCENES = tuple(f"chaos/scene{number:04d}_00" for number in range(4))

_DAYS = 3 * 86_400.0


@dataclasses.dataclass(frozen=True)
class Operation:
    """One line of a story: what is done, and to what."""

    name: str
    what: str = ""
    tag: int = 0

    @property
    def is_harmless(self) -> bool:
        """Whether it is done by the teller of the story, whom nobody kills."""
        return self.name in ("age", "batch")


def story(rng: random.Random, length: int) -> list[Operation]:
    """A sequence of operations that is possible, with what leaves nothing over at its end."""
    operations: list[Operation] = []
    tags: dict[str, int] = {}
    committed: set[str] = set()
    backed_up = is_whole = False
    releases = batches = restored = 0

    def tell(name: str, what: str = "", tag: int = 0) -> None:
        operations.append(Operation(name, what, tag))

    def commit() -> None:
        tell("commit")
        committed.update(tags)

    for scene in SCENES[:2]:
        tags[scene] = 0
        tell("scene", scene)
    commit()
    while len(operations) < length:
        name = rng.choices(_NAMES, _WEIGHTS)[0]
        present = sorted(committed & tags.keys())
        if name == "scene":
            for scene in rng.sample(SCENES, rng.randint(1, 3)):
                tags[scene] = tags.get(scene, -1) + 1
                tell("scene", scene, tags[scene])
            if rng.random() < 0.8:
                commit()
        elif name == "vacuum":
            tell("age")
            tell("vacuum")
        elif name == "release":
            releases += 1
            tell("release", f"v{releases}")
        elif name == "annotate" and present:
            batches += 1
            tell("batch", json.dumps(present), batches)
            tell("annotate", f"batch-{batches}")
        elif name in ("erase", "remove") and len(present) > 1:
            scene = rng.choice(present)
            committed.discard(scene)
            tags.pop(scene)
            tell(name, scene)
        elif name in ("commit", "compact", "sweep"):
            if name == "commit":
                committed.update(tags)
            tell(name)
        elif name == "backup":
            backed_up, is_whole = True, True
            tell(name)
        elif name == "restore" and backed_up and is_whole:
            restored += 1
            tell(name, f"restored{restored}")
    for name in ("commit", "sweep", "age", "vacuum"):
        tell(name)
    return operations


_NAMES = ("scene", "commit", "compact", "vacuum", "release", "annotate", "erase", "remove", "backup", "restore", "sweep")
_WEIGHTS = (5, 2, 2, 2, 2, 2, 2, 1, 2, 2, 1)


def perform(operation: Operation, place: Path) -> Any:
    """Do it. What was done already is left; what comes back says something about the result."""
    from warehouse.lake import Lake

    lake = Lake.open(place / "lake")
    match operation.name:
        case "scene":
            return work_on(lake, operation.what, operation.tag)
        case "commit":
            made = lake.commit("chaos")
            return made.snapshot_id if made else None
        case "sweep":
            return lake.sweep()
        case "compact":
            from warehouse.upkeep.compaction import compact

            return compact(lake).snapshot_id
        case "vacuum":
            from warehouse.upkeep.vacuum import vacuum

            return vacuum(lake, days=0).files
        case "remove":
            lake.remove_scene(operation.what)
            return None
        case "erase":
            from warehouse.upkeep.erasure import erase

            proof = erase(lake, operation.what).proof
            if proof is None or proof.hits:
                raise AssertionError(f"{operation.what} is still found: {proof}")
            return None
        case "release":
            from warehouse.release import make_release, releases

            if operation.what not in {release.name for release in releases(lake)}:
                make_release(lake, operation.what)
            return None
        case "annotate":
            from flows.inputs.annotation import import_annotations

            return import_annotations(lake, place / "batches" / f"{operation.what}.json")["annotations"]
        case "backup":
            from warehouse.upkeep.backup import backup

            return backup(lake, place / "backup").files
        case "restore":
            return _restore(place, operation.what)
        case "age":
            return age(place / "lake")
        case "batch":
            return _write_batch(place / "batches", f"batch-{operation.tag}", json.loads(operation.what))
    raise ValueError(operation.name)


def work_on(lake: Any, scene: str, tag: int, shared: object = "of all") -> bool:
    """Stage what is missing of a scene, as a run does it: claimed, present, one stage after another. Whether it was ours to do."""
    from warehouse.tables.adoption import SCENE_STAGES

    with lake.claims() as claims, lake.presence({"scenes": 1}):
        if not claims.claim(scene):
            return False
        states = lake.history([scene])
        for stage in SCENE_STAGES:
            state = states.get((scene, stage))
            if state is None or state.done is None or state.done.fingerprint != fingerprint(scene, tag, stage):
                stage_part(lake, scene, stage, tag, at=tag * 100.0, shared=shared)
    return True


def age(folder: Path) -> None:
    """Let all blobs be days old: younger ones are nobody's to remove."""
    for path in (folder / "blobs").rglob("*"):
        if path.is_file():
            seconds = path.stat().st_mtime - _DAYS
            os.utime(path, (seconds, seconds))


def _restore(place: Path, name: str) -> str:
    """Restore the backup into a lake of its own; the digest of its rows."""
    from warehouse.lake import Lake
    from warehouse.tables.digest import digests
    from warehouse.upkeep.backup import restore

    target = place / name
    if not (target / "lake.json").is_file() or (target / "restore.json").is_file():
        restore(place / "backup", target)
    return fingerprint(sorted(digests(Lake.open(target).snapshot()).items()))


def _write_batch(folder: Path, batch: str, scenes: Sequence[str]) -> None:
    """A file of answers about all objects of some scenes."""
    folder.mkdir(parents=True, exist_ok=True)
    answers = [
        {"scene_id": scene, "instance_id": instance, "annotator": "ada", "answered_at": "2026-03-01T14:05:00+00:00", "choice": None}
        for scene in scenes
        for instance in INSTANCES
    ]
    (folder / f"{batch}.json").write_text(json.dumps({"batch_id": batch, "annotations": answers}))
