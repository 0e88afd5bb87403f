"""How a piece of work dies: a forked child that is killed before its n-th step, at a moment, or finds its disk full.

The parent must never have used Arrow, DuckDB or delta-rs itself: their threads do not survive a fork. A step is a call that
changes files: one of the system's that the lake's storage makes, or one of delta-rs, which makes many at a time. What delta-rs and
DuckDB do inside is hit by kills at a moment.
"""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import random
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

Way = Literal["step", "moment", "full"]

HANG_SECONDS = 900.0
"""A piece of work on a tiny lake that takes longer hangs: it is killed, and that is a fault."""

JUMPS = ("+0", "-1", "+1", "-90", "+90", "-7200", "+7200", "-40d", "+40d")
"""What clocks are set wrong by, and jump to in the middle of the work."""

_SYSTEM = ("replace", "link", "fsync", "unlink", "mkdir", "rmdir", "utime")


@dataclasses.dataclass(frozen=True)
class Death:
    """How to die. `at` is the step (from 1) for `step` and `full`, seconds after the start for `moment`."""

    way: Way
    at: float


@dataclasses.dataclass(frozen=True)
class End:
    """How a child ended. killed: by what was wanted. error: what it said, and where. steps: how many it made, 0 where it could not say."""

    killed: bool = False
    hung: bool = False
    error: str = ""
    steps: int = 0
    seconds: float = 0.0
    value: Any = None

    @property
    def is_done(self) -> bool:
        """Whether the work was done to its end."""
        return not (self.killed or self.hung or self.error)


class Steps:
    """Counts the steps of this process, and dies or finds the disk full at one of them. For a child: there is no way back."""

    def __init__(self, death: Death | None, jump: tuple[int, str] | None = None) -> None:
        self.count = 0
        self._death, self._jump = death, jump
        self._turn = threading.Lock()  # a commit writes several tables at a time

    def install(self) -> Steps:
        """Put itself before every step of this process."""
        from warehouse.tables.datafiles import changing

        for owner, name in [(os, name) for name in _SYSTEM] + changing():
            setattr(owner, name, self._stepped(getattr(owner, name)))
        return self

    def _stepped(self, real: Callable[..., Any]) -> Callable[..., Any]:
        makes_room = real.__name__ in ("unlink", "rmdir")

        def call(*arguments: Any, **named: Any) -> Any:
            with self._turn:
                self.count += 1
                count = self.count
            if self._jump is not None and count == self._jump[0]:
                os.environ["FAKETIME"] = self._jump[1]
            death = self._death
            if death is not None and death.way == "step" and count == death.at:
                os.kill(os.getpid(), signal.SIGKILL)
            if death is not None and death.way == "full" and count >= death.at and not makes_room:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return real(*arguments, **named)

        return call


def started(work: Callable[[], Any], log: Path, death: Death | None = None, clock: random.Random | None = None) -> int:
    """Fork a child that does `work` and dies as it should; its process id. `told` is where it leaves what came of it.

    With `clock`, the child's clock is wrong, and perhaps jumps: for a process that runs under libfaketime.
    """
    log.unlink(missing_ok=True)
    offset, jump = (clock.choice(JUMPS), (clock.randrange(1, 80), clock.choice(JUMPS))) if clock is not None else (None, None)
    child = os.fork()
    if child:
        return child
    code = 0
    try:
        if offset is not None:
            os.environ["FAKETIME"] = offset
        steps = Steps(death, jump).install()
        answer: dict[str, Any] = {}
        try:
            answer["value"] = work()
        except BaseException as error:
            code = 1
            ours = [f for f in traceback.extract_tb(error.__traceback__) if "/warehouse/" in f.filename or "/flows/" in f.filename]
            place = f" at {Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else ""
            answer["error"] = f"{type(error).__name__}: {' '.join(str(error).split())[:400]}{place}"
        text = json.dumps(answer | {"steps": steps.count})
        steps._death = None
        log.write_text(text)
    except BaseException as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        code = 2
    os._exit(code)


def ended(child: int, log: Path, death: Death | None = None, seconds: float = HANG_SECONDS) -> End:
    """Wait for a child, and kill it when its moment comes; how it ended."""
    begun = time.monotonic()
    moment = death.at if death is not None and death.way == "moment" else None
    hung = False
    while True:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            break
        passed = time.monotonic() - begun
        hung = passed > seconds
        if hung or (moment is not None and passed >= moment):
            os.kill(child, signal.SIGKILL)
            status = os.waitpid(child, 0)[1]
            break
        time.sleep(0.002 if moment is not None else 0.01)
    return end_of(os.waitstatus_to_exitcode(status), log, hung, time.monotonic() - begun)


def end_of(code: int, log: Path, hung: bool = False, seconds: float = 0.0) -> End:
    """How a child with an exit code ended, of which `told` may say more."""
    if hung:
        return End(hung=True, seconds=seconds)
    if code == -signal.SIGKILL:
        return End(killed=True, seconds=seconds)
    answer: dict[str, Any] = json.loads(log.read_text()) if log.exists() else {"error": f"exit code {code}"}
    return End(error=answer.get("error", ""), steps=answer.get("steps", 0), seconds=seconds, value=answer.get("value"))


def tells_of_full_disk(error: str) -> bool:
    """Whether an error says that there is no room."""
    return any(words in error for words in ("ENOSPC", "No space left", "os error 28", "Errno 28", "not enough space", "disk is full"))


def forked(work: Callable[[], Any], log: Path, death: Death | None = None, clock: random.Random | None = None) -> End:
    """Let a child do `work`; how it ended."""
    return ended(started(work, log, death, clock), log, death)
