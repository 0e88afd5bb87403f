"""Upkeep of a lake that dies at every step in turn. `python -m tests.warehouse.upkeep.upkeep_kills COMMAND ... LAKE FOLDER`.

erase SCENE | compact | vacuum | backup. For every n: a copy of LAKE is made below FOLDER, the command runs on it and
dies before the n-th step that changes a file, readers look, the command runs again, readers look again. Prints one JSON
object per n; the last one is of the run that nobody killed. Steps that are alike are killed at a few of them only.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.warehouse.lake_load import _forked
from warehouse.lake import Lake
from warehouse.tables.digest import digests
from warehouse.upkeep.inspection import inspect

_ALIKE = 2


def _step_kind(name: str, arguments: tuple[Any, ...]) -> str:
    """What a step does, without which file."""
    path = str(arguments[1]) if len(arguments) > 1 and isinstance(arguments[1], str) else ""
    parts = path.split("/")
    return " ".join([name, parts[0], parts[1] if parts[0] == "tables" and len(parts) > 1 and parts[1] == "snapshots" else ""])


def _die_at(step: int, seen: list[str]) -> None:
    """Let this process die without a word before the n-th step; `seen` takes in the kinds of the steps."""
    import deltalake

    from warehouse.storage.files import LocalStorage

    def stepped(name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            seen.append(_step_kind(name, arguments))
            if len(seen) == step:
                os._exit(9)
            return real(*arguments, **named)

        return call

    for name in ("write", "create", "remove", "swap", "move_in"):
        setattr(LocalStorage, name, stepped(name, getattr(LocalStorage, name)))
    deltalake.write_deltalake = stepped("write_deltalake", deltalake.write_deltalake)
    for name in ("restore", "create_write_transaction", "create_checkpoint"):
        setattr(deltalake.DeltaTable, name, stepped(name, getattr(deltalake.DeltaTable, name)))


def _work(command: list[str], copy: Path, folder: Path) -> Callable[[], Any]:
    lake = Lake.open(copy)
    match command:
        case ["erase", scene]:
            from warehouse.upkeep.erasure import erase

            return lambda: erase(lake, scene, timeout=300)
        case ["compact"]:
            from warehouse.upkeep.compaction import compact

            return lambda: compact(lake, timeout=300)
        case ["vacuum"]:
            from warehouse.upkeep.vacuum import vacuum

            return lambda: vacuum(lake, days=0)
        case ["backup"]:
            from warehouse.upkeep.backup import backup

            return lambda: backup(lake, folder / "backup")
    raise ValueError(command)


def _seen(address: Path) -> Any:
    """What readers see: the last snapshot's digests; None where there is no lake yet."""
    lake = Lake.open(address)
    return digests(lake.snapshot()) if lake.exists else None


def _kept(address: Path) -> list[Any]:
    """Id, note and digests of every snapshot that is kept."""
    lake = Lake.open(address)
    return [(row.snapshot_id, row.note, digests(lake.snapshot(row.snapshot_id))) for row in lake.snapshot().snapshots]


def main(command: list[str], source: Path, folder: Path) -> None:
    """See the module."""
    copy = folder / "lake"
    looked_at = folder / "backup" if command == ["backup"] else copy

    def written(name: str, value: Any) -> None:
        (folder / name).write_text(json.dumps(value))

    def dying(step: int) -> None:
        seen: list[str] = []
        _die_at(step, seen)
        _work(command, copy, folder)()
        written("steps", seen)

    def again() -> None:
        done = _work(command, copy, folder)()
        proof = getattr(done, "proof", None)
        findings = [str(finding) for finding in inspect(Lake.open(looked_at)).findings]
        found = {"seen": _seen(looked_at), "kept": _kept(looked_at) if command[0] == "erase" else []}
        written("after", found | {"hits": len(proof.hits) if proof else 0, "findings": findings})

    def tried(step: int) -> dict[str, Any]:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(source, copy)
        _forked(lambda: written("first", _seen(looked_at)))
        code = _forked(lambda: dying(step))
        ends = [_forked(lambda: written("before", _seen(looked_at))), _forked(again)]
        read = {name: json.loads((folder / name).read_text()) for name in ("first", "before", "after")}
        after = read.pop("after")
        return {"step": step, "code": code if ends == [0, 0] else ends, "after": after["seen"]} | read | {
            "hits": after["hits"], "findings": after["findings"], "kept": after["kept"],
        }  # fmt: skip

    whole = tried(0)
    steps: list[str] = json.loads((folder / "steps").read_text())
    count: dict[str, int] = {}
    for step, kind in enumerate(steps, 1):
        count[kind] = count.get(kind, 0) + 1
        is_last = kind not in steps[step:]
        if count[kind] <= _ALIKE or is_last:
            print(json.dumps(tried(step) | {"kind": kind}), flush=True)
    print(json.dumps(whole), flush=True)


if __name__ == "__main__":
    *words, source, folder = sys.argv[1:]
    main(words, Path(source), Path(folder))
