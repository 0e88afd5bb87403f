"""Batches of kills in real runs: workers and coordinators of one run, and of two runs with different settings on one lake at once."""

from __future__ import annotations

import random
import subprocess
import time
from pathlib import Path

from bench.flows.chaos import COMMAND_SECONDS, _workers, disturbed_run
from bench.flows.runs import command_of, measured_run, surroundings
from bench.flows.services import plain_server
from bench.flows.small_scenes import SETTINGS, write_small_scans
from bench.flows.verdicts import verdict_on
from bench.kills.stories import KillBatch
from warehouse.lake import Lake

SCENES = 4

OTHER_SETTINGS = (*SETTINGS, "selection.alignment.yaw_count=8", "optimization.method.max_moves=400")
"""Of the run that meets another: from `selection` on, nothing of the two is the same."""

_PAUSES = (0.2, 2.0)
_STUBBORN = 20


def prepared(folder: Path) -> tuple[Path, Lake]:
    """Scans, and the lake of a run that nobody disturbs; made once."""
    scans, lake = folder / "scans", folder / "lake"
    if not scans.exists():
        write_small_scans(scans, SCENES)
    if not (folder / "made").exists():
        measured_run("pool", scans, lake, 2, folder)
        (folder / "made").touch()
    return scans, Lake.open(lake)


def of_one_run(seed: int, kills: int, folder: Path, peace: Path) -> KillBatch:
    """A run whose workers and whose coordinator are killed."""
    batch, begun = KillBatch("runs", seed), time.monotonic()
    scans, undisturbed = prepared(peace)
    with plain_server(folder / "server") as server:
        end = disturbed_run(
            scans, folder / "run", undisturbed, {"server": server}, kills=kills, seed=seed, pauses=_PAUSES,
            targets=("worker", "worker", "run"),
        )  # fmt: skip
    for kill in end.kills:
        batch.kills[{"worker": "worker of a run", "run": "coordinator of a run"}[kill.what]] += 1
    batch.operations = len(end.codes)
    if end.codes[-1]:
        batch.faults.append(f"the run ended with {end.codes[-1]}")
    batch.faults += [f"hung {end.hung} times"] if end.hung else []
    batch.faults += [f"lost and not said so: {name}" for name in end.unsaid] + [f"computed again: {name}" for name in end.redone]
    for kind in ("different", "doubled", "computed_twice", "leftovers", "unnamed_blobs", "findings"):
        batch.faults += [f"{kind}: {line}" for line in getattr(end.verdict, kind)]
    batch.seconds = time.monotonic() - begun
    return batch


def of_two_configs(seed: int, kills: int, folder: Path, peace: Path) -> KillBatch:
    """Two runs with different settings over the same scans on one lake at once, killed and given again until both end well.

    Whose rows are in the lake then is open. The first, given once more, leaves the lake as if it had been alone.
    """
    batch, begun, rng = KillBatch("configs", seed), time.monotonic(), random.Random(f"configs {seed}")
    scans, undisturbed = prepared(peace)
    lake = folder / "lake"
    commands = [command_of("pool", scans, lake, 1, settings) for settings in (SETTINGS, OTHER_SETTINGS)]
    with plain_server(folder / "server") as server:
        environment = {**surroundings(folder), **server.access}
        codes = _met(commands, environment, folder, batch, rng, kills)
        if codes == [0, 0]:
            lake_after = Lake.open(lake)
            left = verdict_on(lake_after, lake_after)
            batch.faults += [f"after both: {line}" for line in (*left.doubled, *left.leftovers, *left.findings)]
            with (folder / "last.log").open("wb") as log:
                last = subprocess.run(commands[0], env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log, check=False)
            if last.returncode:
                batch.faults.append(f"the last run ended with {last.returncode}")
    verdict = verdict_on(Lake.open(lake), undisturbed)
    for kind in ("different", "doubled", "leftovers", "findings"):  # whose blobs remain, and how often each was computed, is open
        batch.faults += [f"{kind}: {line}" for line in getattr(verdict, kind)]
    batch.seconds = time.monotonic() - begun
    return batch


def _met(
    commands: list[list[str]], environment: dict[str, str], folder: Path, batch: KillBatch, rng: random.Random, kills: int
) -> list[int]:
    """Both commands at once until each ended well, or is beyond help; their last exit codes."""
    processes: list[subprocess.Popen[bytes] | None] = [None, None]
    codes, given = [-1, -1], [0, 0]
    give_up = time.monotonic() + COMMAND_SECONDS
    try:
        while any(code != 0 for code in codes):
            for index, process in enumerate(processes):
                if process is None and codes[index] != 0:
                    given[index] += 1
                    with (folder / f"run{index}-{given[index]}.log").open("wb") as log:
                        processes[index] = subprocess.Popen(
                            commands[index], env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
                        )  # fmt: skip
            time.sleep(rng.uniform(*_PAUSES))
            alive = [process for process in processes if process is not None and process.poll() is None]
            if alive and batch.kills.total() < kills:
                _strike(rng.choice(alive), batch, rng)
            for index, process in enumerate(processes):
                if process is not None and process.poll() is not None:
                    codes[index], processes[index] = process.returncode, None
            batch.operations = sum(given)
            if time.monotonic() > give_up or max(given) > _STUBBORN + kills or any(code in (2, 3) for code in codes):
                batch.faults.append(f"the runs ended with {codes} after {given} commands")
                break
    finally:
        for process in processes:
            if process is not None and process.poll() is None:
                process.kill()
                process.wait()
    return codes


def _strike(process: subprocess.Popen[bytes], batch: KillBatch, rng: random.Random) -> None:
    """Kill a coordinator, or a worker of it where there is one."""
    workers = _workers(process.pid)
    if workers and rng.random() < 0.6:
        rng.choice(workers).kill()
        batch.kills["worker of two runs"] += 1
    else:
        process.kill()
        process.wait()
        batch.kills["coordinator of two runs"] += 1
