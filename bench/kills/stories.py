"""Batches of kills on lakes of made-up rows: one operation after another, or eight writers and upkeep at once."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import random
import signal
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from bench.kills.accounts import faults_of
from bench.kills.death import Death, End, Way, end_of, forked, started, tells_of_full_disk
from bench.kills.operations import Operation, perform, story, work_on

WRITERS = 8

_KILLS_IN_A_ROW = 4
_STEPS_AT_FIRST = 60
_SECONDS_AT_FIRST = 0.6


@dataclasses.dataclass
class KillBatch:
    """What came of a batch. kills: by what was killed and how. full: pieces of work that found the disk full, by what they were."""

    kind: str
    seed: int
    kills: Counter[str] = dataclasses.field(default_factory=Counter)
    full: Counter[str] = dataclasses.field(default_factory=Counter)
    faults: list[str] = dataclasses.field(default_factory=list)
    operations: int = 0
    seconds: float = 0.0

    def as_json(self) -> dict[str, Any]:
        """As plain values."""
        return dataclasses.asdict(self) | {"kills": dict(sorted(self.kills.items())), "full": dict(sorted(self.full.items()))}


class Teller:
    """Tells a story on a lake with kills, and on its twin without."""

    def __init__(self, batch: KillBatch, folder: Path, wanted: int, rng: random.Random, clock: random.Random | None, ways: tuple[Way, ...]):
        self._batch, self._folder, self._wanted, self._rng, self._clock, self._ways = batch, folder, wanted, rng, clock, ways
        self._place, self._twin, self._told = folder / "disturbed", folder / "twin", folder / "told.json"
        self._steps: dict[str, int] = {}
        self._seconds: dict[str, float] = {}
        for place in (self._place, self._twin):
            place.mkdir(parents=True, exist_ok=True)

    def tell(self, length: int) -> None:
        """All of a story; faults go into the batch."""
        for number, operation in enumerate(story(self._rng, length), 1):
            self._batch.operations += 1
            self._told_once(number, operation)
            if self._batch.faults:
                return
        self._batch.faults += verdict(self._place / "lake", self._twin / "lake", self._told)

    def _told_once(self, number: int, operation: Operation) -> None:
        """An operation until it is done, and once on the twin."""
        name = f"{number} {operation.name} {operation.what}"
        before = None if operation.is_harmless else self._look(self._place)
        seen = []
        if not operation.is_harmless:
            for _ in range(_KILLS_IN_A_ROW):
                if self._rng.random() < 0.15 or self._batch.kills.total() >= self._wanted:
                    break
                seen += self._disturbed(name, operation)
        end = forked(lambda: perform(operation, self._place), self._told, clock=self._clock)
        self._learn(operation, end)
        alone = forked(lambda: perform(operation, self._twin), self._told)
        for who, state in (("", end), ("undisturbed: ", alone)):
            if not state.is_done:
                self._batch.faults.append(f"{name}: {who}{'hung' if state.hung else state.error or 'died'}")
        if operation.name in ("restore", "annotate") and end.value != alone.value:
            self._batch.faults.append(f"{name}: gave {end.value}, undisturbed {alone.value}")
        after = None if operation.is_harmless else self._look(self._place)
        for state in seen:
            if state not in (before, after):
                self._batch.faults.append(f"{name}: after a kill readers saw neither what was nor what will be: {state}")

    def _disturbed(self, name: str, operation: Operation) -> list[Any]:
        """Begin an operation and let it die; what readers see then, where they look."""
        way = self._rng.choice(self._ways)
        steps, seconds = self._steps.get(operation.name, _STEPS_AT_FIRST), self._seconds.get(operation.name, _SECONDS_AT_FIRST)
        at = self._rng.uniform(0.0, 1.1 * seconds) if way == "moment" else self._rng.randint(1, max(1, steps))
        death = Death(way, at)
        end = forked(lambda: perform(operation, self._place), self._told, death, self._clock)
        if end.killed:
            self._batch.kills[f"{operation.name} at a {way}"] += 1
        elif way == "full" and end.error:
            self._batch.full[operation.name] += 1
            if not tells_of_full_disk(end.error):
                self._batch.faults.append(f"{name}: a full disk is told as {end.error}")
        elif not end.is_done:
            self._batch.faults.append(f"{name}: {'hung' if end.hung else end.error}")
        return [self._look(self._place)] if self._rng.random() < 0.4 else []

    def _look(self, place: Path) -> Any:
        """What readers see: a digest of all rows of the last snapshot."""
        end = forked(lambda: seen(place / "lake"), self._told, clock=self._clock)
        return end.value if end.is_done else end.error

    def _learn(self, operation: Operation, end: End) -> None:
        """How many steps and seconds such an operation takes: the most so far, so that kills fall on all of it."""
        self._steps[operation.name] = max(self._steps.get(operation.name, 0), end.steps)
        self._seconds[operation.name] = max(self._seconds.get(operation.name, 0.0), end.seconds)


def crashing(
    seed: int, kills: int, folder: Path, clock: bool = False, ways: tuple[Way, ...] = ("step", "step", "moment", "full")
) -> KillBatch:
    """A batch of one story after another until there were so many kills."""
    batch = KillBatch("clock" if clock else "lake", seed)
    rng = random.Random(f"story {seed}")
    number = 0
    while batch.kills.total() < kills and not batch.faults:
        number += 1
        teller = Teller(batch, folder / str(number), kills, rng, random.Random(f"clock {seed} {number}") if clock else None, ways)
        teller.tell(rng.randint(14, 26))
    return batch


def crowded(seed: int, kills: int, folder: Path, clock: bool = False) -> KillBatch:
    """Eight writers and upkeep at once on one lake, killed and begun again until all is done."""
    batch, rng = KillBatch("clock writers" if clock else "writers", seed), random.Random(f"writers {seed}")
    place, twin = folder / "disturbed", folder / "twin"
    for home in (place, twin):
        home.mkdir(parents=True, exist_ok=True)
    names = [f"chaos/scene{number:04d}_00" for number in range(WRITERS * 2)]
    # Of its three scenes, every writer shares one with its neighbor.
    shares = [[names[2 * i], names[2 * i + 1], names[(2 * i + 2) % len(names)]] for i in range(WRITERS)]
    crowd = _Crowd(batch, folder, rng, random.Random(f"clock {seed}") if clock else None, kills)
    roles: dict[str, Callable[[], Any]] = {f"writer {i}": _writer(place, share) for i, share in enumerate(shares)}
    crowd.work(roles, {"upkeep": _upkeep(place, rng.random())})
    for scene in names:
        forked(partial(perform, Operation("scene", scene), twin), folder / "told")
    for home in (place, twin):
        for operation in ("commit", "sweep", "age", "vacuum"):
            work = partial(perform, Operation(operation), home)
            end = forked(work, folder / "told")
            if not end.is_done:
                batch.faults.append(f"{operation}: {end.error or 'died'}")
    batch.operations = len(names)
    batch.faults += verdict(place / "lake", twin / "lake", folder / "told")
    return batch


class _Crowd:
    """Processes at once, some of which are killed and begun again."""

    def __init__(self, batch: KillBatch, folder: Path, rng: random.Random, clock: random.Random | None, wanted: int) -> None:
        self._batch, self._folder, self._rng, self._clock, self._wanted = batch, folder, rng, clock, wanted
        self._children: dict[int, str] = {}
        self._doomed = 0

    def work(self, roles: dict[str, Callable[[], Any]], upkeep: dict[str, Callable[[], Any]]) -> None:
        """Until every role is done; upkeep goes on for as long."""
        every = roles | upkeep
        for role, member in every.items():
            self._begin(role, member)
        give_up = time.monotonic() + 1800
        left = set(roles)
        while left:
            self._strike()
            for role, end in self._ended():
                if end.killed:
                    self._batch.kills[f"{role.split()[0]} of {WRITERS} at once"] += 1
                elif not end.is_done:
                    self._batch.faults.append(f"{role}: {end.error}")
                    left.discard(role)
                else:
                    left.discard(role)
                if end.killed or (role in upkeep and left and end.is_done):
                    self._begin(role, every[role])
            if time.monotonic() > give_up:
                self._batch.faults.append(f"hung: {', '.join(sorted(left))}")
                break
        for child in self._children:
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)

    def _begin(self, role: str, work: Callable[[], Any]) -> None:
        dies = self._doomed < self._wanted and self._rng.random() < 0.7
        self._doomed += dies
        death = Death("step", self._rng.randint(1, 250 if role.startswith("writer") else 120)) if dies else None
        child = started(work, self._folder / f"{role}.told", death, self._clock)
        self._children[child] = role

    def _strike(self) -> None:
        """Wait a moment, and kill somebody, perhaps."""
        time.sleep(self._rng.uniform(0.0, 0.1))
        if self._children and self._doomed < self._wanted and self._rng.random() < 0.2:
            self._doomed += 1
            os.kill(self._rng.choice(sorted(self._children)), signal.SIGKILL)

    def _ended(self) -> list[tuple[str, End]]:
        ends = []
        for child, role in list(self._children.items()):
            pid, status = os.waitpid(child, os.WNOHANG)
            if pid:
                del self._children[child]
                ends.append((role, end_of(os.waitstatus_to_exitcode(status), self._folder / f"{role}.told")))
        return ends


def _writer(place: Path, share: list[str]) -> Callable[[], Any]:
    def work() -> None:
        from warehouse.lake import Lake

        lake = Lake.open(place / "lake")
        left = list(share)
        while left:
            left = [scene for scene in left if not work_on(lake, scene, 0)]
            # As a run: its own scenes, and those of which no writer lives.
            own = [scene for scene in share if scene not in left]
            lake.commit("a writer", scenes=[*own, *lake.abandoned()])
            if left:
                time.sleep(0.05)

    return work


def _upkeep(place: Path, draw: float) -> Callable[[], Any]:
    def work() -> None:
        if not (place / "lake" / "lake.json").is_file():
            time.sleep(0.05)
            return
        for name in ("compact", "vacuum", "backup") if draw < 0.5 else ("compact", "sweep"):
            if name != "backup" or any((place / "lake" / "tables" / "snapshots").glob("*.parquet")):
                perform(Operation(name), place)

    return work


def seen(folder: Path) -> str:
    """A digest of all rows of a lake's last snapshot."""
    from bench.samples import fingerprint
    from warehouse.lake import Lake
    from warehouse.tables.digest import digests

    return fingerprint(sorted(digests(Lake.open(folder).snapshot()).items()))


def verdict(lake: Path, twin: Path, log: Path) -> list[str]:
    """What is wrong with a lake that was swept and vacuumed: by its files, by its digests and by its own inspection."""

    def look() -> list[str]:
        from warehouse.lake import Lake
        from warehouse.upkeep.inspection import inspect

        faults = faults_of(lake, twin)
        if seen(lake) != seen(twin):
            faults.append("the digests are not those of the undisturbed lake")
        return faults + [f"doctor lake: {finding}" for finding in inspect(Lake.open(lake)).findings]

    end = forked(look, log)
    return list(end.value) if end.is_done else [f"the verdict failed: {end.error or 'died'}"]
