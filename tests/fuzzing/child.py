"""The process that reads inputs. It says which one it begins before it does, so that one that kills it is known.

Run as `python -m tests.fuzzing.child`, with a job in JSON on its standard input; a line of JSON for every event on its
standard output. The kernel ends it when an input takes too many seconds of a core, and refuses memory beyond a limit.
"""

from __future__ import annotations

import dataclasses
import faulthandler
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from random import Random
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from schemas.errors import LakeError
from tests.conftest import REPOSITORY
from tests.fuzzing.cases import Case, packed, unpacked, write_case
from tests.fuzzing.doors import Refused, Target
from tests.fuzzing.mutations import changed


@dataclasses.dataclass(frozen=True)
class Limits:
    """What no input may need more of: seconds of a core, and bytes of memory."""

    seconds: float = 30.0
    bytes: int = 2 * 10**9


_BURST = 8
"""Inputs for every number that Hypothesis draws: drawing takes longer than reading a small file."""

ROOMS = ("schemas", "tasks", "warehouse", "flows")


def main() -> None:
    """Do the job that the standard input tells of."""
    job = json.load(sys.stdin)
    events = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what is printed by anybody else is no event
    warnings.simplefilter("ignore")
    faulthandler.enable(all_threads=False)
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    faulthandler.register(signal.SIGPROF, all_threads=False, chain=True)
    limits = Limits(**job["limits"])
    with tempfile.TemporaryDirectory(dir=job["place"]) as place:
        for name, count in job["counts"].items():
            target = registry(job["module"])[name]
            if job["within"]:
                target = dataclasses.replace(target, read=target.within or target.read)
            cases = [unpacked(json.loads(Path(file).read_text())["files"]) for file in job["files"].get(name, ())]
            run = _Run(target, cases or sound_cases(target, Path(job["seeds"])), Path(place), events, limits)
            if job["reached"]:
                reached = _reached(run.read_sound)
                events.write(json.dumps({"event": "reached", "functions": sorted(reached)}) + "\n")
            else:
                run.read_sound()
            if count:
                run.read_changed(count, job["seed"])
            events.write(json.dumps({"event": "end", "target": name}) + "\n")


def registry(module: str) -> dict[str, Target]:
    """The targets that a module has."""
    found: dict[str, Target] = import_module(module).targets()
    return found


def _reached(read: Callable[[], None]) -> set[str]:
    """Our own functions that are called meanwhile, as `tasks/capture/files/ply.py _header`."""
    seen: set[Any] = set()
    sys.setprofile(lambda frame, event, _: seen.add(frame.f_code) if event == "call" else None)
    try:
        read()
    finally:
        sys.setprofile(None)
    paths = [(Path(code.co_filename), code.co_qualname) for code in seen]
    return {f"{path.relative_to(REPOSITORY)} {name}" for path, name in paths if path.is_relative_to(REPOSITORY)}


def sound_cases(target: Target, folder: Path) -> list[Case]:
    """The sound inputs of a target, written only once."""
    file = folder / f"{target.name.replace(' ', '_')}.json"
    if not file.is_file():
        new = file.with_suffix(f".{os.getpid()}")
        new.write_text(json.dumps([packed(case) for case in target.seeds()]))
        new.replace(file)
    return [unpacked(document) for document in json.loads(file.read_text())]


class _Run:
    """Inputs of one target, one after the other."""

    def __init__(self, target: Target, sound: Sequence[Case], place: Path, events: Any, limits: Limits) -> None:
        self.target, self.sound, self.place, self.events, self.limits = target, sound, place, events, limits
        self.number = 0

    def read_sound(self) -> None:
        """Read what is sound. It loads every library, so that inputs are measured and not imports."""
        for index in range(len(self.sound)):
            self._read(index, [])
        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (size + self.limits.bytes, resource.getrlimit(resource.RLIMIT_AS)[1]))

    def read_changed(self, count: int, number: int) -> None:
        """Read so many inputs. Hypothesis draws numbers; each says which sound inputs to take, and how they are changed."""
        left = count

        @seed(number)
        @settings(
            max_examples=-(-count // _BURST), database=None, deadline=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck)
        )
        @given(st.integers(0, 2**64 - 1))
        def drawn(told: int) -> None:
            nonlocal left
            random = Random(f"{number} {told}")
            for _ in range(min(_BURST, left)):
                left -= 1
                self._read(random.randrange(len(self.sound)), [random.getrandbits(64) for _ in range(random.choice((1, 1, 2, 3)))])

        drawn()

    def _read(self, index: int, plan: Sequence[int]) -> None:
        self.events.write(json.dumps({"event": "start", "target": self.target.name, "sound": index, "plan": plan}) + "\n")
        case = changed(self.sound[index], self.sound, plan)
        self.number += 1
        folder = self.place / str(self.number) / "case"
        write_case(case, folder)
        event = measured(self.target, folder, self.limits)
        shutil.rmtree(folder.parent, ignore_errors=True)
        self.events.write(json.dumps({"event": "read", **event}) + "\n")


def measured(target: Target, folder: Path, limits: Limits) -> dict[str, Any]:
    """Read a case: outcome `read`, `refused` or `failed`, what was wrong, seconds of a core and bytes of memory at the most."""
    Path("/proc/self/clear_refs").write_text("5")  # the peak of memory starts anew
    signal.setitimer(signal.ITIMER_PROF, limits.seconds)
    before, children = os.times(), _peak_of_children()
    began = time.monotonic()
    outcome, error, where = "read", "", ""
    try:
        target.read(folder)
    except (LakeError, Refused) as refusal:
        outcome, error = "refused", str(refusal)
        wrong = _wrong_refusal(refusal)
        if wrong:
            outcome, error, where = "failed", wrong, _where(refusal)
    except BaseException as failure:
        if isinstance(failure, KeyboardInterrupt):
            raise
        outcome, error, where = "failed", f"{type(failure).__name__}: {str(failure)[:300]}", _where(failure)
    signal.setitimer(signal.ITIMER_PROF, 0)
    after = os.times()
    used = sum(after[:4]) - sum(before[:4])
    risen = _peak_of_children()  # the largest of all children ever; only one that is larger than those before it tells of this input
    peak = max(_peak(), risen if risen > children else 0)
    if outcome != "failed" and used > limits.seconds:
        outcome, error = "failed", f"took {used:.0f} seconds"
    if outcome != "failed" and peak > limits.bytes:
        outcome, error = "failed", f"took {peak / 1e9:.1f} GB"
    return {
        "outcome": outcome, "error": error, "where": where, "seconds": used, "bytes": peak, "clock": time.monotonic() - began
    }  # fmt: skip


def _wrong_refusal(refusal: BaseException) -> str:
    """What is wrong with a refusal: it is no line, cannot be printed, or hides that memory ran out."""
    text = str(refusal)
    chain: BaseException | None = refusal
    while chain is not None:
        if isinstance(chain, MemoryError):
            return f"MemoryError: {str(chain)[:200]}"
        chain = chain.__cause__ or chain.__context__
    if isinstance(refusal, LakeError) and ("\n" in text or "\r" in text):
        return f"refusal of several lines: {text[:200]!r}"
    try:
        text.encode()
    except UnicodeEncodeError:
        return f"refusal that cannot be printed: {text[:200]!a}"
    return ""


def _where(error: BaseException) -> str:
    """The last place in our own code that an error went through."""
    found = ""
    for frame in traceback.extract_tb(error.__traceback__):
        path = Path(frame.filename)
        if path.is_relative_to(REPOSITORY) and path.relative_to(REPOSITORY).parts[0] in ROOMS:
            found = f"{path.relative_to(REPOSITORY)} {frame.name}"
    return found


def _peak_of_children() -> int:
    """Most memory [bytes] of any process that was waited for."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024


def _peak() -> int:
    """Most memory [bytes] since it was last reset."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    return 0


if __name__ == "__main__":
    main()
