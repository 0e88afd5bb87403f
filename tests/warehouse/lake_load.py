"""A process that works on a lake, for tests that let several of them meet or die. `python -m tests.warehouse.lake_load ...`.

writer LAKE FIRST COUNT ROUNDS   stage and commit scenes FIRST .. FIRST+COUNT, ROUNDS times over
hold LAKE                        take the lease, say so, and hold it until killed
half LAKE                        stage half a run and a temporary file, say so, and wait to be killed
crashes LAKE FOLDER STRIDE       commit copies of LAKE, dying at every STRIDE-th step in turn (see `crashes`)
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Scene
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake
from warehouse.tables.digest import digests


def scene_id(number: int) -> str:
    """Name of a scene."""
    return f"demo/s{number:03d}_00"


def stage_scene(lake: Lake, number: int, tag: object, at: float) -> None:
    """Stage capture, captions and candidates of a scene; `tag` is what the rows say."""
    scene = scene_id(number)
    capture, captions, candidates = (fingerprint(scene, tag, name) for name in ("capture", "captions", "candidates"))
    blob = lake.blobs.put(f"{scene}{tag}".encode(), "glb")
    lake.stage_rows(
        stage_run(scene, "capture", capture, at=at), {"scenes": [sample(Scene, scene_id=scene, mesh_blob=blob, license=str(tag))]}
    )
    texts = [sample(Caption, scene_id=scene, instance_id=f"{i:04d}", sentence=str(tag)) for i in range(5)]
    lake.stage_rows(stage_run(scene, "captions", captions, f"capture={capture}", at=at + 0.1), {"captions": texts})
    # Neighbors share an asset, and each has one of its own.
    names = [f"shared {number // 2}", f"own {number} {tag}"]
    assets = [sample(Asset, asset_id=fingerprint(name), name=name, mesh_blob=lake.blobs.put(b"mesh", "glb")) for name in names]
    slots = [sample(Candidate, scene_id=scene, instance_id="0001", slot=i + 1, asset_id=row.asset_id) for i, row in enumerate(assets)]
    run = stage_run(scene, "candidates", candidates, f"capture={capture}", f"captions={captions}", at=at + 0.2)
    lake.stage_rows(run, {"candidates": slots, "assets": assets})


def writer(lake: Lake, first: int, count: int, rounds: int) -> None:
    """Stage and commit, over and over."""
    for i in range(rounds):
        for number in range(first, first + count):
            stage_scene(lake, number, i, at=i * 1000 + number)
            if number % 3 == 0:
                lake.commit(scenes=[scene_id(n) for n in range(first, number + 1)])
        lake.commit()


def half(lake: Lake) -> None:
    """Stop while a run is staged and while a file is written."""
    replace, named = os.replace, 0

    def stop(source: Path, target: Path) -> None:
        nonlocal named
        named += 1
        if named == 2:  # of the rows and of the run: the rows have their name, the run is a temporary file
            print("half", flush=True)
            time.sleep(600)
        replace(source, target)

    os.replace = stop  # type: ignore[assignment]
    lake.stage_rows(
        stage_run(scene_id(1), "captions", fingerprint(1)), {"captions": [sample(Caption, scene_id=scene_id(1), sentence="half")]}
    )


def _die_at(step: int) -> Callable[[], int]:
    """Let this process die without a word before the n-th step that changes a file; the returned function counts them."""
    import deltalake
    from deltalake.table import TableOptimizer

    from warehouse.storage.files import LocalStorage

    count, turn = 0, threading.Lock()

    def stepped(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            nonlocal count
            with turn:  # tables are written by several threads
                count += 1
                if count == step:
                    os._exit(9)
            return real(*arguments, **named)

        return call

    for name in ("write", "create", "remove", "swap"):
        setattr(LocalStorage, name, stepped(getattr(LocalStorage, name)))
    deltalake.write_deltalake = stepped(deltalake.write_deltalake)
    deltalake.DeltaTable.restore = stepped(deltalake.DeltaTable.restore)  # type: ignore[method-assign]
    TableOptimizer.compact = stepped(TableOptimizer.compact)  # type: ignore[method-assign]
    return lambda: count


def _forked(work: Callable[[], None]) -> int:
    """Exit code of a forked child that does `work`. This process never used delta-rs itself, whose threads do not survive a fork."""
    child = os.fork()
    if child == 0:
        try:
            work()
        except BaseException as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
            os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def crashes(prepared: Path, folder: Path, stride: int) -> None:
    """For every `stride`-th step n of a commit: copy the lake, commit until step n, look at it, commit again, sweep, look again.

    Prints one JSON object per n: exit code of the first commit, the digests of what readers see after it (null: the
    lake could not be read), after the second commit, and the files that are left in staged/ and tmp/.
    """
    for step in range(1, 1000, stride):
        copy = folder / "lake"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(prepared, copy)

        def dying(step: int = step, copy: Path = copy) -> None:
            counted = _die_at(step)
            Lake.open(copy).commit("crashing")
            (folder / "steps").write_text(str(counted()))

        def look(name: str, copy: Path = copy) -> None:
            reader = Lake.open(copy).snapshot()
            (folder / name).write_text(json.dumps([reader.snapshot_id, digests(reader)]))

        def again(copy: Path = copy) -> None:
            lake = Lake.open(copy)
            lake.commit("again", timeout=300)
            lake.sweep(timeout=300)
            look("after")

        code = _forked(dying)
        seen = _forked(lambda: look("before"))
        second = _forked(again)
        places = [copy / "lease.json", *(copy / "staged").rglob("*"), *(copy / "tmp").rglob("*")]
        left = sorted(str(path.relative_to(copy)) for path in places if path.is_file())
        read = {name: json.loads((folder / name).read_text()) if (folder / name).exists() else None for name in ("before", "after")}
        print(json.dumps({"step": step, "codes": [code, seen, second], "left": left} | read), flush=True)
        if code != 9:
            return


if __name__ == "__main__":
    command, address, *rest = sys.argv[1:]
    if command == "crashes":
        crashes(Path(address), Path(rest[0]), int(rest[1]))
    elif command == "writer":
        writer(Lake.open(address), *map(int, rest))
    elif command == "half":
        half(Lake.open(address))
    elif command == "hold":
        from warehouse.sharing.lease import Lease

        with Lease(Lake.open(address).storage):
            print("held", flush=True)
            time.sleep(600)
