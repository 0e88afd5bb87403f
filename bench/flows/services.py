"""A Prefect server on a PostgreSQL cluster of its own, on loopback, for as long as a measurement lasts. Both can be killed."""

from __future__ import annotations

import abc
import contextlib
import os
import pwd
import random
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from bench.flows.runs import surroundings
from flows.server.access import CLIENT_TOKEN, SERVER_TOKEN, new_token
from flows.server.process import QUIET, is_healthy
from schemas.errors import InputError, LakeError
from schemas.machine.environment import child_environment

START_SECONDS = 120
"""The first start of a Prefect server migrates an empty database: 10 s on two idle cores, much more on busy ones."""

_ROLE = "metascenes"
_PORTS = range(20_000, 32_000)  # below those that systems give to outgoing connections: a killed server finds its port free


class Process(abc.ABC):
    """A server process that dies with this one. It can be killed and started again, on the same port and data."""

    url = ""

    def __init__(self, name: str, folder: Path) -> None:
        self.access: dict[str, str] = {}
        self.name, self.port = name, _free_port()
        self._log = folder / f"{name}.log"
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it and wait until it answers.

        Raises:
            LakeError: it ended, or did not answer in time; with the end of its log.
        """
        with self._log.open("ab") as log:
            self._process = self._started(log)
        give_up = time.monotonic() + START_SECONDS
        while not self.answers():
            if self._process.poll() is not None or time.monotonic() > give_up:
                self.kill()
                raise LakeError(f"{self.name} did not start: {self._log.read_text(errors='replace').strip()[-1000:]}")
            time.sleep(0.05)

    def kill(self) -> None:
        """SIGKILL to all its processes, as when the machine lost power; nothing if it does not run."""
        import psutil

        if self._process is None:
            return
        process, self._process = self._process, None
        with contextlib.suppress(psutil.NoSuchProcess):
            every = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
            for member in every:
                with contextlib.suppress(psutil.NoSuchProcess):
                    member.kill()
            psutil.wait_procs(every, timeout=10)
        process.wait()

    @abc.abstractmethod
    def answers(self) -> bool:
        """Whether it serves."""

    @abc.abstractmethod
    def _started(self, log: IO[bytes]) -> subprocess.Popen[bytes]:
        """Its process, whose words go to `log`."""


class Database(Process):
    """A PostgreSQL cluster, made for this, with one database and a password of its own."""

    def __init__(self, folder: Path) -> None:
        super().__init__("postgresql", folder)
        self._programs = postgres_programs()
        # PostgreSQL refuses to be root, and its own user must reach the data.
        self.home = Path(tempfile.mkdtemp(prefix="metascenes-postgres-"))
        password, file = secrets.token_hex(16), self.home / "password"
        file.write_text(password)
        if os.geteuid() == 0:
            for path in (self.home, file):
                shutil.chown(path, "postgres", "postgres")
        made = [str(self._programs / "initdb"), "-D", str(self.home / "data"), "-U", _ROLE, "-A", "scram-sha-256", f"--pwfile={file}",
                "-E", "UTF8", "--locale=C.UTF-8", "--no-sync"]  # fmt: skip
        done = subprocess.run([*_owner(), *made], cwd="/", env=child_environment(), capture_output=True, text=True, check=False)
        if done.returncode:
            raise LakeError(f"initdb: {done.stderr.strip()[-500:]}")
        self.url = f"postgresql+asyncpg://{_ROLE}:{password}@127.0.0.1:{self.port}/postgres"

    def answers(self) -> bool:
        """Whether it takes queries: after a kill it recovers first."""
        ready = [str(self._programs / "pg_isready"), "-q", "-h", "127.0.0.1", "-p", str(self.port)]
        return subprocess.run(ready, env=child_environment(), check=False).returncode == 0

    def _started(self, log: IO[bytes]) -> subprocess.Popen[bytes]:
        settings = {"listen_addresses": "127.0.0.1", "port": self.port, "unix_socket_directories": "", "max_connections": 200}
        given = [part for name, value in settings.items() for part in ("-c", f"{name}={value}")]
        command = [*_owner(), str(self._programs / "postgres"), "-D", str(self.home / "data"), *given]
        return subprocess.Popen(command, cwd="/", env=child_environment(), stdin=subprocess.DEVNULL, stdout=log, stderr=log)


class Server(Process):
    """A Prefect server on a database, its own SQLite file unless one is given.

    `access` are the variables that lead to it: its address and its token.
    """

    def __init__(self, folder: Path, database: str | None = None) -> None:
        super().__init__("prefect", folder)
        self.url = f"http://127.0.0.1:{self.port}/api"
        named = {"PREFECT_API_DATABASE_CONNECTION_URL": database} if database else {}
        token = new_token()
        self.access = {"PREFECT_API_URL": self.url, CLIENT_TOKEN: token}
        self._environment = {**surroundings(folder), **QUIET, **named, SERVER_TOKEN: token}

    def answers(self) -> bool:
        """Whether the API says that it is well."""
        return is_healthy(self.url)

    def _started(self, log: IO[bytes]) -> subprocess.Popen[bytes]:
        with socket.socket() as listener:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(("127.0.0.1", self.port))
            listener.listen(128)
            command = [sys.executable, "-m", "flows.server", "--socket", str(listener.fileno()), "--follow", str(os.getpid())]
            return subprocess.Popen(
                command, env=self._environment, pass_fds=[listener.fileno()], stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )


@contextlib.contextmanager
def plain_server(folder: Path) -> Iterator[Server]:
    """A Prefect server on a SQLite file in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    server = Server(folder)
    try:
        server.start()
        yield server
    finally:
        server.kill()


@contextlib.contextmanager
def services(folder: Path) -> Iterator[dict[str, Process]]:
    """A Prefect server on PostgreSQL: `server` and `database`, both up. Their logs lie in `folder`.

    Raises:
        InputError: PostgreSQL is not installed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    database = Database(folder)
    server = Server(folder, database.url)
    try:
        database.start()
        server.start()
        yield {"server": server, "database": database}
    finally:
        server.kill()
        database.kill()
        shutil.rmtree(database.home, ignore_errors=True)


def postgres_programs() -> Path:
    """Folder of the newest PostgreSQL's programs, as Debian installs them, else of those on the path.

    Raises:
        InputError: there are none.
    """
    debian = [path.parent for path in Path("/usr/lib/postgresql").glob("*/bin/postgres") if path.parent.parent.name.isdigit()]
    if debian:
        return max(debian, key=lambda folder: int(folder.parent.name))
    program = shutil.which("initdb")
    if program is None or shutil.which("postgres") is None:
        problem, remedy = "is not installed: it is the database that is killed", "install Debian's `postgresql`, or leave chaos out"
        raise InputError("PostgreSQL", "--parts", problem, remedy)
    return Path(program).resolve().parent


def _owner() -> list[str]:
    """How to become the user that owns the cluster, for root, who may not; and that it is to die with us."""
    if os.geteuid() != 0:
        return ["setpriv", "--pdeathsig", "KILL", "--"]
    user = pwd.getpwnam("postgres")
    return ["setpriv", "--reuid", str(user.pw_uid), "--regid", str(user.pw_gid), "--clear-groups", "--pdeathsig", "KILL", "--"]


def _free_port() -> int:
    """A port of the loopback on which nobody listens."""
    draw = random.SystemRandom()
    while True:
        port = draw.choice(_PORTS)
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            with contextlib.suppress(OSError):
                probe.bind(("127.0.0.1", port))
                return port
