"""Chaos: while a run is at work, its workers, itself, the Prefect server and the server's database are killed at random.

Every kill is a SIGKILL, of real processes. Services come back after a while; the same command is given again until it ends
well. Then the lake is held against that of a run that nobody disturbed.
"""

from __future__ import annotations

import dataclasses
import random
import re
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Protocol

from bench.flows.runs import command_of, surroundings
from bench.flows.small_scenes import SETTINGS
from bench.flows.verdicts import Finished, LakeVerdict, finished, verdict_on
from schemas.runs import StageRun
from warehouse.lake import Lake

COMMAND_SECONDS = 1800.0
"""A command that takes longer hangs: it is killed, and that is told."""

TARGETS = ("worker", "worker", "run", "server", "database")
"""What is killed, those more often that stand more than once."""

_EARLY = 0.2
"""Share of the kills that do not wait until there are workers: they hit a run that begins."""

_STUBBORN = 10
"""So many undisturbed commands in a row may end badly before it is given up."""


class Service(Protocol):
    """A server that can be killed and started again, on the same port and data. `access` are the variables that lead to it."""

    access: dict[str, str]

    def start(self) -> None:
        """Start it and wait until it answers."""

    def kill(self) -> None:
        """SIGKILL to all its processes; nothing if it does not run."""

    def answers(self) -> bool:
        """Whether it serves."""


@dataclasses.dataclass(frozen=True)
class Kill:
    """What was killed, how many seconds after the first command was given, during which command (from 1)."""

    what: str
    seconds: float
    command: int


@dataclasses.dataclass(frozen=True)
class Chaos:
    """What came of it.

    codes: exit codes of the commands, in order; negative for a killed one. lost: stage runs that lost their worker.
    unsaid: those of them of which no output of a run says that they are tried again. redone: stages that were finished
    before a command and computed again by it. hung: commands that were killed because they took too long.
    """

    scenes: int
    seconds: float
    codes: tuple[int, ...]
    kills: tuple[Kill, ...]
    lost: tuple[str, ...]
    unsaid: tuple[str, ...]
    redone: tuple[str, ...]
    hung: int
    verdict: LakeVerdict

    @property
    def kinds(self) -> dict[str, int]:
        """Kills by what was killed."""
        return dict(sorted(Counter(kill.what for kill in self.kills).items()))


def disturbed_run(
    scans: Path, folder: Path, undisturbed: Lake, services: Mapping[str, Service], *, workers: int = 2, kills: int = 12, seed: int = 0,
    runner: str = "pool", settings: Sequence[str] = SETTINGS, pauses: tuple[float, float] = (0.5, 5.0), targets: Sequence[str] = TARGETS,
) -> Chaos:  # fmt: skip
    """Run all scans into `folder/lake`, and kill until `kills` kills have hit. `services` are up: `server`, and perhaps others.

    What is killed is drawn from `targets`: 'worker', 'run' and names of services. A kill comes `pauses` [s] after the one
    before; a killed service is away for up to the longer of them.
    """
    upset = _Upset(scans, folder, services, workers, kills, random.Random(seed), runner, settings, pauses, targets)
    begun = time.monotonic()
    upset.carry_on()
    seconds = time.monotonic() - begun
    lake = Lake.open(folder / "lake")
    lost = sorted({f"{run.scene_id}: {run.stage}" for run in lake.snapshot().rows(StageRun) if run.outcome == "lost"})
    upset_text = upset.output()
    return Chaos(
        scenes=sum(1 for path in scans.iterdir() if path.is_dir()), seconds=seconds, codes=tuple(upset.codes), kills=tuple(upset.kills),
        lost=tuple(lost), unsaid=tuple(name for name in lost if not _is_said(name, upset_text)), redone=tuple(sorted(upset.redone)),
        hung=upset.hung, verdict=verdict_on(lake, undisturbed),
    )  # fmt: skip


class _Upset:
    """One command after another, and what happens to them."""

    def __init__(
        self, scans: Path, folder: Path, services: Mapping[str, Service], workers: int, kills: int, rng: random.Random, runner: str,
        settings: Sequence[str], pauses: tuple[float, float], targets: Sequence[str],
    ) -> None:  # fmt: skip
        self._lake, self._folder, self._services, self._rng, self._pauses = folder / "lake", folder, services, rng, pauses
        self._command = command_of(runner, scans, self._lake, workers, settings)
        self._environment = {**surroundings(folder), **services["server"].access, "PYTHONUNBUFFERED": "1"}
        self._wanted, self._targets = kills, targets
        self._begun = time.monotonic()
        self._finished: Finished = {}
        self.codes: list[int] = []
        self.kills: list[Kill] = []
        self.redone: set[str] = set()
        self.hung = 0

    def carry_on(self) -> None:
        """Give the command until it ends well with nobody left to kill, or is beyond help."""
        self._folder.mkdir(parents=True, exist_ok=True)
        while not self.codes or self.codes[-1] != 0:
            calm = [code for code in self.codes[self._last_upset() :] if code]
            if len(calm) >= _STUBBORN:
                return
            with (self._folder / f"command{len(self.codes) + 1}.log").open("wb") as log:
                self.codes.append(self._given(log))
            self._mend()
            self._compare()

    def output(self) -> str:
        """Everything that the commands printed."""
        return "\n".join(path.read_text(errors="replace") for path in sorted(self._folder.glob("command*.log")))

    def _last_upset(self) -> int:
        """How many commands there were until the last kill."""
        return max((kill.command for kill in self.kills), default=0)

    def _given(self, log: IO[bytes]) -> int:
        """Give the command, and kill meanwhile; its exit code."""
        process = subprocess.Popen(
            self._command, env=self._environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
        )
        give_up = time.monotonic() + COMMAND_SECONDS
        try:
            while len(self.kills) < self._wanted and self._waited(process, give_up):
                self._strike(process)
            return process.wait(give_up - time.monotonic())
        except subprocess.TimeoutExpired:
            self.hung += 1
            return -signal.SIGKILL
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()

    def _waited(self, process: subprocess.Popen[bytes], give_up: float) -> bool:
        """Wait for the next moment to kill, most often while workers are there; whether the command still runs then."""
        early = self._rng.random() < _EARLY
        pause = self._rng.uniform(*self._pauses)
        while process.poll() is None and not early and not _workers(process.pid) and time.monotonic() < give_up:
            time.sleep(0.1)
        until = time.monotonic() + pause
        while process.poll() is None and time.monotonic() < until:
            time.sleep(0.02)
        return process.poll() is None and time.monotonic() < give_up

    def _strike(self, process: subprocess.Popen[bytes]) -> None:
        """Kill something. A service is away for a while, and comes back."""
        what = self._rng.choice(self._targets)
        if what == "run":
            process.kill()
        elif what == "worker":
            workers = _workers(process.pid)
            if not workers:
                return
            self._rng.choice(workers).send_signal(signal.SIGKILL)
        else:
            self._services[what].kill()
        self.kills.append(Kill(what, time.monotonic() - self._begun, len(self.codes) + 1))
        if what in self._services:
            time.sleep(self._rng.uniform(0.0, self._pauses[1]))
            self._services[what].start()

    def _mend(self) -> None:
        """Bring back services that died of the others' death."""
        for service in self._services.values():
            if not service.answers():
                service.kill()
                service.start()

    def _compare(self) -> None:
        """Note what was finished before the command, and is computed anew now."""
        now = finished(Lake.open(self._lake))
        self.redone |= {f"{scene} {stage}" for (scene, stage), run in self._finished.items() if now.get((scene, stage)) != run}
        self._finished = now


def _workers(pid: int) -> list[Any]:
    """Processes that compute for a run."""
    import psutil

    try:
        children = psutil.Process(pid).children(recursive=True)
        return sorted((child for child in children if "--multiprocessing-fork" in child.cmdline()), key=lambda child: child.pid)
    except psutil.Error:
        return []


def _is_said(name: str, text: str) -> bool:
    """Whether a line says that a stage of a scene lost its worker."""
    return re.search(rf"^.*{re.escape(name)}: worker lost\b", text, re.MULTILINE) is not None
