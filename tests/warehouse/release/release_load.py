"""A process that releases a lake and dies, for tests. `python -m tests.warehouse.release.release_load LAKE FOLDER STEP...`

For every STEP: copy the lake, release it as `v1` and die before the STEP-th change of a file; say what is there; release
it again; say what is there then. One JSON object per STEP.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.warehouse.lake_load import _forked
from warehouse.lake import Lake
from warehouse.release import make_release, releases
from warehouse.storage.files import LocalStorage


def main(prepared: Path, folder: Path, steps: list[int]) -> None:
    """Release copies of a lake, dying at some steps."""
    for step in steps:
        shutil.rmtree(folder, ignore_errors=True)
        copy = folder / "lake"
        shutil.copytree(prepared, copy)
        codes = [_forked(lambda step=step, copy=copy: dying(copy, step))]  # type: ignore[misc]
        codes.append(_forked(lambda copy=copy: look(copy, folder / "before")))  # type: ignore[misc]
        codes.append(_forked(lambda copy=copy: again(copy)))  # type: ignore[misc]
        codes.append(_forked(lambda copy=copy: look(copy, folder / "after")))  # type: ignore[misc]
        told = {name: json.loads((folder / name).read_text()) for name in ("before", "after")}
        print(json.dumps({"step": step, "codes": codes} | told), flush=True)


def dying(copy: Path, step: int) -> None:
    """Release, and die before a step."""
    count = 0

    def stepped(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            nonlocal count
            count += 1
            if count == step:
                os._exit(9)
            return real(*arguments, **named)

        return call

    for name in ("write", "create", "remove", "swap", "move_in"):
        setattr(LocalStorage, name, stepped(getattr(LocalStorage, name)))
    make_release(Lake.open(copy), "v1", advance=stepped(lambda table: None))


def again(copy: Path) -> None:
    """Release what is not released yet."""
    lake = Lake.open(copy)
    if not releases(lake):
        make_release(lake, "v1")
    lake.sweep()


def look(copy: Path, file: Path) -> None:
    """Write down the names of the releases, the hashes of the files in their folder, and what is left over."""
    place = copy / "releases" / "v1"
    files = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in place.iterdir()} if place.is_dir() else {}
    names = [release.name for release in releases(Lake.open(copy))]
    left = [str(path.relative_to(copy)) for path in (copy / "tmp").rglob("*")] if (copy / "tmp").is_dir() else []
    file.write_text(json.dumps({"names": names, "files": files, "left": left, "lease": (copy / "lease.json").exists()}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), [int(step) for step in sys.argv[3:]])
