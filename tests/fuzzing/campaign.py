"""Many inputs for many targets: children that read them, what came of it, and where it is kept so that it can go on later."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO, Any

from tests.conftest import REPOSITORY
from tests.fuzzing.cases import Case, packed, size_of
from tests.fuzzing.child import ROOMS, Limits, registry, sound_cases
from tests.fuzzing.mutations import changed

BATCH = 1000
"""Inputs for each child: what one leaves behind in memory weighs on few others."""


@dataclasses.dataclass(frozen=True)
class Reading:
    """How inputs are read: the module whose targets they are for, where sound inputs are kept, and what each may need.

    patience: seconds of the clock in which a child and its children may do nothing at all before they count as waiting for ever.
    within: readers that start a process for every input do without.
    """

    seeds: Path
    module: str = "tests.fuzzing.targets"
    limits: Limits = dataclasses.field(default_factory=Limits)
    patience: float = 45.0
    within: bool = False


@dataclasses.dataclass
class Failure:
    """An input that failed. It is the smallest of those that failed in the same way; `times`: how many there were."""

    error: str
    where: str
    sound: int
    plan: list[int]
    size: int
    times: int = 1


@dataclasses.dataclass
class Record:
    """What came of a target's inputs. seconds: of a core, of the slowest; bytes: of the one that took most; clock: of all [s]."""

    name: str
    wanted: int
    batches: int = 0
    read: int = 0
    refused: int = 0
    failed: int = 0
    seconds: float = 0.0
    bytes: int = 0
    clock: float = 0.0
    failures: dict[str, Failure] = dataclasses.field(default_factory=dict)

    @property
    def inputs(self) -> int:
        """How many were tried."""
        return self.read + self.refused + self.failed

    def add(self, event: Mapping[str, Any], start: Mapping[str, Any], cases: Sequence[Case]) -> None:
        """Count an input. Sound ones do not count, but must not fail."""
        if start["plan"]:
            setattr(self, event["outcome"], getattr(self, event["outcome"]) + 1)
        self.seconds, self.bytes = max(self.seconds, event["seconds"]), max(self.bytes, event["bytes"])
        if event["outcome"] != "failed":
            return
        if not start["plan"]:
            self.failed += 1
        key = f"{event['error'].partition(':')[0]} {event['where']}"
        size = size_of(changed(cases[start["sound"]], cases, start["plan"]))
        known = self.failures.get(key)
        times = known.times + 1 if known else 1
        if known is None or size < known.size:
            known = Failure(event["error"], event["where"], start["sound"], list(start["plan"]), size)
            self.failures[key] = known
        known.times = times


def code_hash() -> str:
    """A hash of all code that inputs go through, and that makes them."""
    digest = hashlib.sha256()
    for room in (*ROOMS, "tests/fuzzing"):
        for path in sorted((REPOSITORY / room).rglob("*.py")):
            digest.update(path.relative_to(REPOSITORY).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


class Campaign:
    """Inputs for targets, so many each. What is in `out` from an earlier campaign over the same code goes on."""

    def __init__(self, out: Path, counts: Mapping[str, int], seed: int, fresh: bool = False, reading: Reading | None = None) -> None:
        self.out, self.seed, self._lock = out, seed, threading.Lock()
        self.reading = reading or Reading(out / "seeds")
        (out / "seeds").mkdir(parents=True, exist_ok=True)
        told = {"code": code_hash(), "seed": seed}
        self._file = out / "records.json"
        known: dict[str, Any] = {}
        if self._file.is_file() and not fresh:
            kept = json.loads(self._file.read_text())
            known = kept["records"] if {name: kept[name] for name in told} == told else {}
        if not known:
            for path in (out / "seeds").glob("*.json"):
                path.unlink()
        self._told = told
        self.records = {name: _record(known.get(name, {"name": name}), count) for name, count in counts.items()}
        self._others = {name: record for name, record in known.items() if name not in counts}

    def run(self, jobs: int, minutes: float, tell: Callable[[Record], None]) -> None:
        """Read all inputs, or those that fit into so many minutes; `tell` is called after every batch."""
        end = time.monotonic() + minutes * 60

        def whole(record: Record) -> None:
            while record.inputs < record.wanted and time.monotonic() < end:
                self._batch(record, min(BATCH, record.wanted - record.inputs))
                with self._lock:
                    self._save()
                tell(record)

        with ThreadPoolExecutor(jobs) as pool:
            list(pool.map(whole, self.records.values()))

    def _batch(self, record: Record, count: int) -> None:
        began = time.monotonic()
        number = int.from_bytes(hashlib.sha256(f"{self.seed} {record.name} {record.batches}".encode()).digest()[:4])
        record.batches += 1
        read_inputs({record.name: count}, number, self.reading, {record.name: record})
        record.clock += time.monotonic() - began
        self._keep(record)

    def _keep(self, record: Record) -> None:
        """Write the inputs that failed."""
        cases = sound_cases(registry(self.reading.module)[record.name], self.reading.seeds)
        for key, failure in record.failures.items():
            folder = self.out / "failures" / record.name.replace(" ", "_")
            folder.mkdir(parents=True, exist_ok=True)
            document = counterexample(record.name, failure, changed(cases[failure.sound], cases, failure.plan))
            (folder / f"{hashlib.sha256(key.encode()).hexdigest()[:12]}.json").write_text(document)

    def _save(self) -> None:
        document = {**self._told, "records": {**self._others, **{name: dataclasses.asdict(one) for name, one in self.records.items()}}}
        new = self._file.with_suffix(".new")
        new.write_text(json.dumps(document, indent=1))
        new.replace(self._file)


def _record(known: Mapping[str, Any], wanted: int) -> Record:
    values = dict(known)
    failures = {key: Failure(**value) for key, value in values.pop("failures", {}).items()}
    return Record(**{**values, "wanted": wanted, "failures": failures})


def counterexample(target: str, failure: Failure, case: Case) -> str:
    """An input that failed, as a file that tests read again."""
    return json.dumps({"target": target, "was": failure.error[:200], "files": packed(case)}, indent=1) + "\n"


def read_inputs(
    counts: Mapping[str, int], number: int, reading: Reading, records: Mapping[str, Record], reached: set[str] | None = None
) -> None:
    """Read so many inputs of each target in one child, or in as many as it takes when some end theirs; counts into `records`.

    reached: Where our functions go that sound inputs come by.
    """
    left = dict(counts)
    while left:
        done = dict.fromkeys(left, 0)
        start: dict[str, Any] = {}
        with child(left, number, reading, reached=reached is not None) as (process, stderr):
            for event in events(process, reading.patience):
                if event["event"] == "end":
                    del left[event["target"]]
                elif event["event"] == "reached":
                    assert reached is not None
                    reached.update(event["functions"])
                elif event["event"] == "start":
                    start = event
                else:
                    _count(records, event, start, reading)
                    done[start["target"]] += bool(start["plan"])
                    start = {}
            process.wait()
            stderr.seek(0)
            said = stderr.read()[-3000:].decode(errors="replace")
        if not left:
            return
        name = next(iter(left))
        if not start:
            raise RuntimeError(f"the child that reads {name} ended with {process.returncode}: {said}")
        event = {"outcome": "failed", "error": _ended(process.returncode, said), "where": _last_frame(said), "bytes": 0}
        event["seconds"] = reading.limits.seconds if process.returncode == -signal.SIGPROF else 0.0
        _count(records, event, start, reading)
        left[name] -= done[name] + bool(start["plan"])
        number += 1
        if left[name] <= 0 or not start["plan"]:
            del left[name]


@contextlib.contextmanager
def child(
    counts: Mapping[str, int], number: int, reading: Reading, files: Mapping[str, Sequence[str]] | None = None, reached: bool = False
) -> Iterator[tuple[subprocess.Popen[bytes], IO[bytes]]]:
    """A child at work, and what it says of its end. files: inputs to read instead of sound ones, by target.

    reached: it also says which of our functions sound inputs come by.
    """
    with tempfile.TemporaryDirectory(dir=_memory()) as place, tempfile.TemporaryFile("w+b") as stderr:
        job = {
            "counts": counts, "seed": number, "place": place, "seeds": str(reading.seeds), "module": reading.module,
            "limits": dataclasses.asdict(reading.limits), "files": files or {}, "reached": reached,
            "within": reading.within,
        }  # fmt: skip
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzzing.child"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=stderr, cwd=REPOSITORY,
            start_new_session=True, env={**os.environ, "DO_NOT_TRACK": "1", "MPLBACKEND": "Agg", "PYTHONUTF8": "1"},
        )  # fmt: skip
        assert process.stdin is not None
        try:
            with process.stdin:
                process.stdin.write(json.dumps(job).encode())
            yield process, stderr
        finally:
            _end(process)


def events(process: subprocess.Popen[bytes], patience: float) -> Iterator[Any]:
    """What a child says, until it ends. One that does nothing for long, nor do its children, waits for what never comes: it is ended."""
    assert process.stdout is not None
    said, idle, before = b"", 0, -1.0
    while True:
        if not select.select([process.stdout], [], [], patience / _LOOKS)[0]:
            used = _seconds(process.pid)
            idle, before = (idle + 1 if used == before else 0), used
            if idle >= _LOOKS:
                process.send_signal(signal.SIGABRT)  # with it goes a line for every call that it was in
                idle = 0
            continue
        idle, new = 0, os.read(process.stdout.fileno(), 2**16)
        if not new:
            return
        *lines, said = (said + new).split(b"\n")
        yield from map(json.loads, lines)


_LOOKS = 9
"""How often an idle child is looked at before it is ended."""


def _seconds(pid: int) -> float:
    """Seconds of a core that a process and its children took, as far as they live."""
    import psutil

    try:
        found = psutil.Process(pid)
        return sum(sum(one.cpu_times()[:2]) for one in (found, *found.children(recursive=True)))
    except psutil.NoSuchProcess:
        return -2.0


def _count(records: Mapping[str, Record], event: Mapping[str, Any], start: Mapping[str, Any], reading: Reading) -> None:
    record = records[start["target"]]
    cases = sound_cases(registry(reading.module)[record.name], reading.seeds) if event["outcome"] == "failed" else ()
    record.add(event, start, cases)


def _ended(code: int, said: str) -> str:
    if code == -signal.SIGPROF:
        return "took more seconds than it may"
    if code == -signal.SIGABRT and "terminate called" not in said:
        return "waited for ever"
    return f"ended its process with {signal.Signals(-code).name if code < 0 else code}: {' '.join(said.split())[-200:]}"


def _last_frame(said: str) -> str:
    """The innermost place of our own code in what faulthandler wrote."""
    for line in said.splitlines():
        file, _, rest = line.strip().removeprefix('File "').partition('", line ')
        path = Path(file)
        if rest and path.is_relative_to(REPOSITORY) and path.relative_to(REPOSITORY).parts[0] in ROOMS:
            return f"{path.relative_to(REPOSITORY)} {rest.rpartition(' in ')[2]}"
    return ""


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a child and what it may have started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _memory() -> str | None:
    """Where files are memory, if anywhere: a million small ones would wear a disk."""
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
