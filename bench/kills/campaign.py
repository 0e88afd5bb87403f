"""A campaign of kills: batches of all kinds in turn until there were enough of them, or time is up. It can be stopped and gone on with.

Every batch is a process of its own, drawn from the campaign's seed and the batch's number, and leaves a line in the campaign's
journal. What a sound batch made is removed; where one found a fault, its lakes stay to be looked at.
"""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.goals import goal
from bench.kills.disk import let_go
from bench.machine import machine
from schemas.errors import InputError

BATCHES: Mapping[str, int] = {
    "lake": 40,
    "writers": 30,
    "clock": 30,
    "disk": 12,
    "clock writers": 20,
    "runs": 8,
    "configs": 6,
}
"""Kinds of batches in the order in which they come, and how many kills each makes; full disks for `disk`."""

KINDS = tuple(BATCHES)

JOURNAL = "journal.jsonl"

_FAKETIME = ("/usr/lib/*/faketime/libfaketimeMT.so.1", "/usr/lib/faketime/libfaketimeMT.so.1")


@dataclasses.dataclass(frozen=True)
class Campaign:
    """What is to be done. minutes: no batch begins after so many. folder: where the journal is, and lakes with faults."""

    folder: Path
    kills: int = 1000
    minutes: float = 120.0
    seed: int = 0
    kinds: tuple[str, ...] = KINDS


def run_campaign(campaign: Campaign, advance: Callable[[str], None] = lambda kind: None) -> dict[str, Any]:
    """Batches until the journal counts enough kills or time is up; the report of all that the journal holds.
    `advance` is told every kill's kind.

    Raises:
        InputError: a kind cannot be done here: libfaketime is not installed, or nothing may be mounted.
    """
    campaign.folder.mkdir(parents=True, exist_ok=True)
    journal = campaign.folder / JOURNAL
    if "clock" in campaign.kinds or "clock writers" in campaign.kinds:
        faketime()
    if "disk" in campaign.kinds:
        from bench.kills.disk import mounted

        with mounted(campaign.folder / "mounted", 1_000_000):
            pass
        (campaign.folder / "mounted").rmdir()
    done = read_journal(journal, campaign.seed)
    until = time.monotonic() + campaign.minutes * 60
    number = max((line["number"] for line in done), default=-1)
    while total_kills(done) < campaign.kills and time.monotonic() < until:
        number += 1
        kind = campaign.kinds[number % len(campaign.kinds)]
        line = _batch(campaign, kind, number, min(BATCHES[kind], max(1, campaign.kills - total_kills(done))))
        with journal.open("a") as file:
            file.write(json.dumps(line) + "\n")
        done.append(line)
        for _ in range(total_kills([line])):
            advance(kind)
    return report(done, campaign.seed, campaign.kills)


def report(done: Sequence[Mapping[str, Any]], seed: int, asked: int = 1) -> dict[str, Any]:
    """Counts by kind, hours, faults, and the verdict as goals; so many kills and full disks were asked for."""
    kills, full = Counter[str](), Counter[str]()
    kinds: dict[str, dict[str, float]] = {}
    faults = []
    for line in done:
        kills.update(line["kills"])
        full.update(line["full"])
        totals = kinds.setdefault(line["kind"], {"batches": 0, "kills": 0, "full": 0, "operations": 0, "faults": 0, "hours": 0.0})
        totals["batches"] += 1
        totals["kills"] += sum(line["kills"].values())
        totals["full"] += sum(line["full"].values())
        totals["operations"] += line["operations"]
        totals["faults"] += len(line["faults"])
        totals["hours"] += line["seconds"] / 3600
        faults += [f"{line['kind']} {line['number']}: {fault}" for fault in line["faults"]]
    return {
        "machine": machine(), "seed": seed, "kinds": kinds, "kills": dict(sorted(kills.items())), "full": dict(sorted(full.items())),
        "hours": sum(totals["hours"] for totals in kinds.values()), "faults": faults,
        "goals": [goal("faults", len(faults), "==", 0), goal("kills", total_kills(done), ">=", asked)],
    }  # fmt: skip


def total_kills(done: Sequence[Mapping[str, Any]]) -> int:
    """Kills of all batches, and disks that were full."""
    return sum(sum(line["kills"].values()) + sum(line["full"].values()) for line in done)


def read_journal(journal: Path, seed: int) -> list[dict[str, Any]]:
    """The batches that were finished with a seed. A line that was cut off is none."""
    entries = []
    for line in journal.read_text().splitlines() if journal.exists() else ():
        try:
            entry = json.loads(line)
        except ValueError:
            continue
        if entry["campaign"] == seed:
            entries.append(entry)
    return entries


def faketime() -> Path:
    """The library that gives a process another clock.

    Raises:
        InputError: it is not installed.
    """
    for pattern in _FAKETIME:
        for path in Path("/").glob(pattern.lstrip("/")):
            return path
    raise InputError(
        "libfaketime", "", "is not installed", "apt-get install libfaketime, or leave out the kinds `clock` and `clock writers`"
    )


def clock_environment() -> dict[str, str]:
    """What makes a process's clock its own: each child sets FAKETIME for itself. Files keep the times that the machine gives them."""
    return {
        "LD_PRELOAD": str(faketime()), "FAKETIME": "+0", "FAKETIME_NO_CACHE": "1", "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        "NO_FAKE_STAT": "1",
    }  # fmt: skip


def _batch(campaign: Campaign, kind: str, number: int, kills: int) -> dict[str, Any]:
    """One batch, in a process of its own; its line in the journal."""
    seed = campaign.seed * 1_000_000 + number
    folder = campaign.folder / f"batch{seed}"
    let_go(folder)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    begun = time.monotonic()
    command = [sys.executable, "-m", "bench.kills.batches", kind, str(seed), str(kills), str(folder), str(campaign.folder / "peace")]
    environment = dict(os.environ) | (clock_environment() if kind.startswith("clock") else {})
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    (folder / "stderr.log").write_text(done.stderr)
    try:
        result = json.loads(done.stdout.strip().splitlines()[-1])
    except (ValueError, IndexError):
        problem = " ".join((done.stderr.strip().splitlines() or ["nothing"])[-1].split())[:500]
        result = {
            "kind": kind,
            "seed": seed,
            "kills": {},
            "full": {},
            "operations": 0,
            "faults": [f"the batch ended with {done.returncode}: {problem}"],
        }
    if not result["faults"]:
        shutil.rmtree(folder, ignore_errors=True)
    return result | {"campaign": campaign.seed, "number": number, "seconds": time.monotonic() - begun}
