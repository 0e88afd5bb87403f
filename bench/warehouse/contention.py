"""Processes that stage, commit, read and die on one lake at once, and whether anybody sees anything wrong.

Every scene is staged twice, capture, captions and candidates each time, and every row says which time it is. Committers take
in scenes that are complete. A reader that finds a scene with a part of its rows, or with rows of both times, has seen half a scene.
"""

from __future__ import annotations

import collections
import dataclasses
import hashlib
import json
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Scene
from schemas.errors import LakeError
from schemas.runs import StageRun

if TYPE_CHECKING:
    from warehouse.lake import Lake
    from warehouse.tables.snapshot import Reader

STAGES = ("capture", "captions", "candidates")
CAPTIONS = 40
"""Objects of a scene."""

SLOTS = 3
"""Candidates of an object: enough for a table that is larger than the others."""

TIMES = 2
"""Each scene is staged, then staged anew, so that rows are both added and replaced."""

_START = datetime(2026, 1, 1, tzinfo=UTC)


@dataclasses.dataclass(frozen=True)
class Contention:
    """What came of it. Anything but zero in `errors`, `halves`, `mixed`, `lost` and `doubled` is a defect.

    errors: Lines that a process died with. halves: scenes of which a reader saw a part. mixed: with rows of two times.
    lost, doubled: rows missing or too many in the end. kills: committers killed, in_commit: those that held the lease then.
    """

    scenes: int
    writers: int
    committers: int
    rows: int
    seconds: float
    commits: int
    kills: int
    in_commit: int
    reads: int
    errors: tuple[str, ...]
    halves: int
    mixed: int
    lost: int
    doubled: int


def contention(
    folder: Path, *, scenes: int = 200, writers: int = 8, committers: int = 2, readers: int = 2, kills: int = 10, seed: int = 0
) -> Contention:
    """Let `writers` stage, `committers` compete and `readers` poll on a new lake; committers are killed `kills` times meanwhile.

    It is over before everything is committed when a process dies of an error.
    """
    from warehouse.lake import Lake

    lake = Lake.open(folder)
    started = time.monotonic()
    share = [range(first, scenes, writers) for first in range(min(writers, scenes))]
    staging = [_process("write", lake, ",".join(map(str, numbers))) for numbers in share]
    reading = [_process("read", lake, str(scenes)) for _ in range(readers)]
    committing = [_process("commit", lake, str(scenes)) for _ in range(committers)]
    random_ = random.Random(seed)
    killed = in_commit = 0
    while any(process.poll() is None for process in (*staging, *committing)):
        if any(process.poll() not in (None, 0) for process in (*staging, *committing, *reading)):
            break  # the others would wait for it for ever
        time.sleep(random_.uniform(0.0, 0.2))
        victim = next((i for i, process in enumerate(committing) if process.poll() is None and _holds_lease(lake, process.pid)), None)
        if killed < kills and victim is not None:
            time.sleep(random_.uniform(0.0, 0.5))  # anywhere in the commit, or just after it
            in_commit += _holds_lease(lake, committing[victim].pid)
            committing[victim].kill()
            committing[victim].communicate()
            killed += 1
            committing[victim] = _process("commit", lake, str(scenes))
    seconds = time.monotonic() - started
    for process in (*staging, *committing, *reading):
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
    errors, seen = [], collections.Counter[str]()
    for process in (*staging, *committing, *reading):
        out, error = process.communicate()
        if process.returncode not in (0, -signal.SIGTERM):
            errors.append((error.strip().splitlines() or [f"exit code {process.returncode}"])[-1])
        for line in out.splitlines():
            seen.update(json.loads(line))
    snapshot = lake.snapshot()
    lost, doubled, mixed = _accounts(snapshot, scenes)
    return Contention(
        scenes=scenes, writers=writers, committers=committers, rows=scenes * rows_per_scene(), seconds=seconds,
        commits=snapshot.snapshot_id, kills=killed, in_commit=in_commit, reads=seen["reads"], errors=tuple(errors),
        halves=seen["halves"], mixed=seen["mixed"] + mixed, lost=lost, doubled=doubled,
    )  # fmt: skip


def rows_per_scene() -> int:
    """Rows of a scene in all tables that the stages write: the scene, its captions and candidates, two assets of its own."""
    return 1 + CAPTIONS + CAPTIONS * SLOTS


def scene_id(number: int) -> str:
    """Name of a scene."""
    return f"contention/scene{number:06d}_00"


def stage_scene(lake: Lake, number: int, tag: str, at: float) -> None:
    """Stage capture, captions and candidates of a scene; every row carries `tag`."""
    scene, mesh = scene_id(number), lake.blobs.put(b"contention", "glb")
    prints = {stage: _hash(scene, tag, stage) for stage in STAGES}
    lake.stage_rows(_run(scene, "capture", prints, at), {"scenes": [_scene(scene, tag, mesh)]})
    lake.stage_rows(_run(scene, "captions", prints, at), {"captions": [_caption(scene, f"{i:04d}", tag) for i in range(CAPTIONS)]})
    assets = [_hash(tag, "shared"), *(_hash(scene, tag, str(slot)) for slot in range(1, SLOTS))]
    candidates = [_candidate(scene, f"{i:04d}", slot + 1, asset, tag) for i in range(CAPTIONS) for slot, asset in enumerate(assets)]
    rows: dict[str, list[Any]] = {"candidates": candidates, "assets": [_asset(asset, mesh) for asset in assets]}
    lake.stage_rows(_run(scene, "candidates", prints, at), rows)


def _write(lake: Lake, numbers: str) -> None:
    """Stage the scenes; anew once they are committed, as a later run would."""
    own = [int(number) for number in numbers.split(",")]
    for round_ in range(TIMES):
        for number in own:
            stage_scene(lake, number, f"time {round_}", at=round_ * 1000.0 + number)
        while round_ + 1 < TIMES and not _are_committed(lake, own, f"time {round_}"):
            time.sleep(0.1)


def _commit(lake: Lake, scenes: str) -> None:
    """Commit what is complete until every scene is there as staged the last time."""
    while not _are_committed(lake, range(int(scenes)), f"time {TIMES - 1}"):
        staged: dict[tuple[str, object], list[str]] = collections.defaultdict(list)
        for run in lake.staging.runs():
            staged[run.run.scene_id, run.run.started_at].append(run.token)
        # By token: another committer may take the scene in first, and its writer begin it anew. Without any, what a killed
        # committer left behind is removed all the same.
        if staged:
            lake.commit("contention", runs={token for tokens in staged.values() if len(tokens) == len(STAGES) for token in tokens})
        time.sleep(0.05)


def _are_committed(lake: Lake, numbers: Sequence[int], tag: str) -> bool:
    """Whether the newest snapshot holds these scenes as they were staged with `tag`."""
    wanted = {scene_id(number): _hash(scene_id(number), tag, STAGES[-1]) for number in numbers}
    states = lake.history(wanted)
    last = [state for (_, stage), state in states.items() if stage == STAGES[-1] and not state.is_staged]
    return {state.scene_id: state.done.fingerprint for state in last if state.done is not None} == wanted


def _read(lake: Lake, scenes: str) -> None:
    """Poll the newest snapshot, and count what must not be seen, until told to stop."""
    stopped = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))
    while not stopped:
        halves, mixed = seen_wrong(lake.snapshot())
        print(json.dumps({"reads": 1, "halves": halves, "mixed": mixed}), flush=True)


def seen_wrong(reader: Reader) -> tuple[int, int]:
    """Scenes of which a snapshot has only a part, and scenes with rows of more than one time."""
    with reader.connect() as connection:
        answer = connection.execute(f"""
            WITH said AS (
                SELECT scene_id, license AS tag, 'scenes' AS part FROM scenes
                UNION ALL SELECT scene_id, sentence, 'captions' FROM captions
                UNION ALL SELECT scene_id, reason, 'candidates' FROM candidates
                UNION ALL SELECT scene_id, reason, 'assets' FROM candidates JOIN assets USING (asset_id)
            ),
            counted AS (
                SELECT scene_id, count(*) AS rows, count(DISTINCT tag) AS tags FROM said GROUP BY scene_id
            )
            SELECT count(*) FILTER (rows <> {rows_per_scene() + CAPTIONS * SLOTS}), count(*) FILTER (tags <> 1) FROM counted
        """).fetchone()
    return (int(answer[0]), int(answer[1])) if answer else (0, 0)


def _accounts(reader: Reader, scenes: int) -> tuple[int, int, int]:
    """Rows missing, rows too many, and scenes that are not as staged the last time."""
    last, lost, doubled = f"time {TIMES - 1}", 0, 0
    wrong: set[str] = set()
    for table, column, count in (("scenes", "license", 1), ("captions", "sentence", CAPTIONS), ("candidates", "reason", CAPTIONS * SLOTS)):
        rows = reader.arrow(table)
        keys = list(zip(*(rows.column(name).to_pylist() for name in _keys(table)), strict=True))
        lost += max(scenes * count - len(set(keys)), 0)
        doubled += len(keys) - len(set(keys))
        wrong |= {
            scene for scene, tag in zip(rows.column("scene_id").to_pylist(), rows.column(column).to_pylist(), strict=True) if tag != last
        }
    assets = reader.arrow("assets").column("asset_id").to_pylist()
    lost += max(scenes * (SLOTS - 1) + 1 - len(set(assets)), 0)
    doubled += len(assets) - len(set(assets))
    return lost, doubled, len(wrong)


def _keys(table: str) -> tuple[str, ...]:
    from schemas.tables import TABLES

    return TABLES[table].key


def _holds_lease(lake: Lake, pid: int) -> bool:
    """Whether a process holds the lake's lease, so that killing it now interrupts a commit."""
    from warehouse.sharing.lease import PATH
    from warehouse.sharing.writer import writer_of

    lease = lake.storage.read_tagged(PATH)
    writer = writer_of(json.loads(lease[0]).get("token", "")) if lease else None
    return writer is not None and writer.pid == pid


def _process(role: str, lake: Lake, argument: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "bench.warehouse.contention", role, lake.address, argument]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _run(scene: str, stage: str, prints: dict[str, str], at: float) -> StageRun:
    above = STAGES[: STAGES.index(stage)]
    return StageRun(
        scene_id=scene, stage=stage, fingerprint=prints[stage], attempt=1, outcome="done",
        upstream=tuple(f"{name}={prints[name]}" for name in above), reasons=(), config="{}", row_counts=(), degradations=(), error=None,
        error_kind=None, started_at=_START + timedelta(seconds=at), seconds=1.0, host="bench", peak_memory_mb=1.0, snapshot_id=0,
    )  # fmt: skip


def _scene(scene: str, tag: str, mesh: str) -> Scene:
    return Scene(
        scene_id=scene, room_id=scene.removesuffix("_00"), dataset="contention", scan=scene.partition("/")[2], scan_format="glb",
        scan_path="", alignment=(1.0,) * 16, alignment_source="identity", to_original=(1.0,) * 16,
        floor_tilt_radians=0.0, mesh_blob=mesh, vertex_count=3,
        face_count=1, frame_count=0, instance_count=CAPTIONS, segmentation="file", license=tag,
    )  # fmt: skip


def _caption(scene: str, instance: str, tag: str) -> Caption:
    return Caption(
        scene_id=scene, instance_id=instance, provider="bench", provider_version="1", is_fallback=False, sentence=tag, colors=(),
        color_shares=(), materials=(), shape="flat", body_type="rigid", density_kg_m3=500.0, solid_fraction=0.5, mass_kg=1.0,
        friction=0.5, restitution=0.1, attribute_source="bench", appearance_call_id=None, physics_call_id=None,
    )  # fmt: skip


def _candidate(scene: str, instance: str, slot: int, asset: str, tag: str) -> Candidate:
    return Candidate(
        scene_id=scene, instance_id=instance, slot=slot, provider="bench", provider_version="1", is_fallback=False, outcome="filled",
        reason=tag, asset_id=asset, seed=None, call_id=None, library=None, library_file=None, library_score=None,
        twin_of=None, seen_share=None, seconds=None,
    )  # fmt: skip


def _asset(asset: str, mesh: str) -> Asset:
    return Asset(
        asset_id=asset, provider="bench", name="bench", category="box", source="bench", license="CC0-1.0", author=None, mesh_blob=mesh,
        pieces_blob=None, extents=(1.0, 1.0, 1.0), volume_m3=1.0, is_watertight=True, vertex_count=8, face_count=12,
        open_reason=None, has_texture=False, source_url=None, thumbnail_blob=None,
    )  # fmt: skip


def _hash(*words: str) -> str:
    return hashlib.sha256("|".join(words).encode()).hexdigest()


_ROLES: dict[str, Callable[[Any, str], None]] = {"write": _write, "commit": _commit, "read": _read}


def _main(arguments: Sequence[str]) -> int:
    """A process of its own: `python -m bench.warehouse.contention ROLE LAKE ARGUMENT`."""
    from warehouse.lake import Lake

    role, address, argument = arguments
    try:
        _ROLES[role](Lake.open(address), argument)
    except LakeError as error:
        print(f"{role}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1:]))
