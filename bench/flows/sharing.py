"""Two runs over overlapping scenes at the same time: each scene is to be computed once, by either of them."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.flows.runs import command_of, surroundings
from bench.flows.small_scenes import SETTINGS
from bench.flows.verdicts import LakeVerdict, verdict_on
from warehouse.lake import Lake


@dataclasses.dataclass(frozen=True)
class Sharing:
    """What came of it. computed: scenes that each run computed; shared: those that it left to the other, or found done by it.

    both: scenes that both say they computed. neither: scenes that neither says so of.
    """

    scenes: int
    overlap: int
    seconds: float
    codes: tuple[int, ...]
    computed: tuple[int, ...]
    shared: tuple[int, ...]
    both: tuple[str, ...]
    neither: tuple[str, ...]
    verdict: LakeVerdict


def shared_runs(
    scans: Path, folder: Path, undisturbed: Lake, server: Mapping[str, str], *, workers: int = 1, runners: Sequence[str] = ("pool", "pool"),
    settings: Sequence[str] = SETTINGS,
) -> Sharing:  # fmt: skip
    """Start two runs at once, the first over all scenes but the last third, the second over all but the first third.

    Both tell the Prefect server to which the variables `server` lead.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = sorted(path.name for path in scans.iterdir() if path.is_dir())
    third = len(names) // 3
    parts = [names[: len(names) - third], names[third:]]
    begun = time.monotonic()
    environment = {**surroundings(folder), **server}
    processes = []
    for number, (runner, part) in enumerate(zip(runners, parts, strict=True), 1):
        command = [*command_of(runner, scans, folder / "lake", workers, settings), "--first", f"scannet/{part[0]}", "--last",
                   f"scannet/{part[-1]}", "--json"]  # fmt: skip
        with (folder / f"run{number}.log").open("wb") as log:
            processes.append(subprocess.Popen(
                command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log
            ))  # fmt: skip
    outputs = [process.communicate()[0] for process in processes]
    seconds = time.monotonic() - begun
    reports: list[dict[str, Any]] = [json.loads(text) if text.strip() else {} for text in outputs]
    done = [set(report.get("done", ())) for report in reports]
    return Sharing(
        scenes=len(names), overlap=len(set(parts[0]) & set(parts[1])), seconds=seconds,
        codes=tuple(process.returncode for process in processes), computed=tuple(len(stages) for stages in done),
        shared=tuple(len(report.get("shared", ())) for report in reports), both=tuple(sorted(done[0] & done[1])),
        neither=tuple(sorted({f"scannet/{name}" for name in names} - done[0] - done[1])),
        verdict=verdict_on(Lake.open(folder / "lake"), undisturbed),
    )  # fmt: skip
