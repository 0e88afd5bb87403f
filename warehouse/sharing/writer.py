"""Who writes: a process, named so that anybody can tell whether it still lives.

A name is `<machine>-<pid>-<start>`: the machine (host name, boot and process namespace, hashed), the process id
and when the process started. A process id alone is reused by the system; together with the start it is not.
"""

from __future__ import annotations

import dataclasses
import itertools
import os
import re
import threading

from schemas.machine.processes import machine_name, start_of

# Tests give a process the name of another machine.
_machine, _process_start = machine_name, start_of

_counter = itertools.count(1)
_counter_lock = threading.Lock()

# As `new_token` writes it, and no looser: people's files have names with hyphens and numbers, too.
_TOKEN = re.compile(r"([0-9a-f]{8})-([0-9]{1,10})-([0-9a-f]{1,20})-[0-9]+")


@dataclasses.dataclass(frozen=True)
class Writer:
    """A process that writes to a lake."""

    machine: str
    pid: int
    start: str

    def __str__(self) -> str:
        return f"{self.machine}-{self.pid}-{self.start}"

    @property
    def is_here(self) -> bool:
        """Whether the process is of this machine, so that `is_alive` can tell."""
        return self.machine == _machine()

    @property
    def is_alive(self) -> bool:
        """Whether the process lives. Only known for writers of this machine; others are taken to live."""
        return not self.is_here or _process_start(self.pid) == self.start


def this_writer() -> Writer:
    """The process that runs this code."""
    pid = os.getpid()
    return Writer(_machine(), pid, _process_start(pid) or "0")


def new_token() -> str:
    """A name that nobody else uses, carrying who made it: `<machine>-<pid>-<start>-<number>`."""
    with _counter_lock:
        number = next(_counter)
    return f"{this_writer()}-{number}"


def writer_of(token: str) -> Writer | None:
    """The writer that made `token`, or None when it is no token."""
    parts = _TOKEN.fullmatch(token)
    return Writer(parts[1], int(parts[2]), parts[3]) if parts else None
