"""Facts about processes that outlive them: the machine's name and the moment of a start.

A process id alone is reused by the system; together with the start it is not.
"""

from __future__ import annotations

import functools
import hashlib
import os
import socket
from pathlib import Path

NAME_LETTERS = 8
"""Letters of a hash in a name: enough to tell the machines of one lake apart."""


@functools.cache
def machine_name() -> str:
    """Hash of host name, boot and process namespace: process ids are comparable only within these."""
    return short_hash(socket.gethostname(), boot_name(), namespace_name())


@functools.cache
def host_name() -> str:
    """Hash of facts that stay the same when this host starts again, and differ on others."""
    try:
        machine_id = Path("/etc/machine-id").read_text().strip()
    except OSError:
        machine_id = ""
    return short_hash(socket.gethostname(), machine_id, namespace_name())


@functools.cache
def boot_name() -> str:
    """Name of this start of the system; '' outside of Linux."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""


@functools.cache
def namespace_name() -> str:
    """Name of the process namespace, which a container has of its own; '' outside of Linux."""
    try:
        return os.readlink("/proc/self/ns/pid")
    except OSError:
        return ""


def short_hash(*facts: str) -> str:
    """Hash of facts, short enough for the name of a file."""
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()[:NAME_LETTERS]


def start_of(pid: int) -> str | None:
    """Start of process `pid`, as the system counts it; None if there is no such process (a zombie does not count)."""
    try:
        # The second field is the program's name in brackets and may hold anything: count from the last bracket.
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        if fields[0] in ("Z", "X") and len(os.listdir(f"/proc/{pid}/task")) < 2:
            return None
        # Of a killed process whose first thread is gone, others may still be in the middle of a write.
        return fields[19]
    except (FileNotFoundError, ProcessLookupError):
        if Path("/proc/self/stat").exists():
            return None
    return _start_without_proc(pid)


def _start_without_proc(pid: int) -> str | None:
    """Start of a process where there is no /proc: macOS."""
    import psutil

    try:
        process = psutil.Process(pid)
        if process.status() == psutil.STATUS_ZOMBIE:
            return None
        return f"{int(process.create_time() * 1e6):x}"
    except psutil.NoSuchProcess:
        return None
