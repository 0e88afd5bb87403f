"""Real services for tests, on free ports of the loopback: PostgreSQL, a Prefect server, moto's S3 server.

Each starts below the guard of `flows.server.services`, which takes in all its descendants and ends them when the test process is
gone, however that ended.
"""

from __future__ import annotations

import abc
import atexit
import base64
import contextlib
import os
import pwd
import random
import re
import secrets
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from functools import cache, cached_property
from importlib import metadata
from pathlib import Path
from typing import Any

import psutil

from flows.server.access import CLIENT_TOKEN, SERVER_TOKEN, new_token
from flows.server.process import is_healthy

REPOSITORY = Path(__file__).resolve().parent.parent
START_SECONDS = 120
"""The first start of a Prefect server migrates an empty database: 10 s on two idle cores, much more on busy ones."""

PORTS = range(20_000, 32_000)
"""Below the range from which systems take ports of outgoing connections: a killed service finds its port free again."""

ROLE = "metascenes"


class Service(abc.ABC):
    """A server process that can be killed and started again, on the same port and data. `url` is where it answers."""

    url: str

    def __init__(self, name: str, folder: Path) -> None:
        self.name = name
        self.folder = folder
        self.port = free_port()
        self.log = folder / f"{name}.log"
        self.environment: dict[str, str] = {}
        self._guard: subprocess.Popen[bytes] | None = None
        self._lifeline = -1
        folder.mkdir(parents=True, exist_ok=True)

    @abc.abstractmethod
    def command(self) -> list[str]:
        """What is started."""

    def answers(self) -> bool:
        """Whether it serves."""
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def start(self) -> None:
        """Start it, again if it was killed or stopped, and wait until it answers.

        Raises:
            RuntimeError: it ended, or did not answer in time; with the end of its log.
        """
        if self._guard is not None:
            raise RuntimeError(f"{self.name} runs already")
        theirs, self._lifeline = os.pipe()
        with self.log.open("ab") as log:
            self._guard = subprocess.Popen(
                [sys.executable, "-m", "flows.server.services", str(theirs), "0", *self.command()],
                cwd=REPOSITORY, env=self._surroundings(), pass_fds=[theirs],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip
        os.close(theirs)
        give_up = time.monotonic() + START_SECONDS
        while not self.answers():
            if self._guard.poll() is not None or time.monotonic() > give_up:
                said = self.log.read_text(errors="replace")[-3000:]
                self.kill()
                raise RuntimeError(f"{self.name} did not start:\n{said}")
            time.sleep(0.05)

    def _surroundings(self) -> dict[str, str]:
        """The environment of the process: ours, without what leads Prefect elsewhere."""
        return {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")} | self.environment

    def processes(self) -> list[psutil.Process]:
        """Every process of the service, the guard left out."""
        if self._guard is None:
            return []
        try:
            return psutil.Process(self._guard.pid).children(recursive=True)
        except psutil.NoSuchProcess:
            return []

    def kill(self) -> None:
        """SIGKILL to all its processes at once, as when the machine lost power; nothing if it does not run."""
        if self._guard is None:
            return
        guard, self._guard = self._guard, None
        if guard.poll() is None:
            _kill_below(psutil.Process(guard.pid))
            with contextlib.suppress(subprocess.TimeoutExpired):
                guard.wait(10)  # it takes in the dead: a process that nobody waited for looks alive to its successor
        guard.kill()
        guard.wait()
        os.close(self._lifeline)

    def stop(self, polite: signal.Signals = signal.SIGTERM, seconds: float = 20) -> None:
        """End it as its administrator would; by SIGKILL what still runs after `seconds`."""
        if self._guard is not None:
            for child in psutil.Process(self._guard.pid).children():
                with contextlib.suppress(psutil.NoSuchProcess):
                    child.send_signal(polite)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._guard.wait(seconds)
        self.kill()


class Postgres(Service):
    """A PostgreSQL cluster. `url` leads Prefect to an empty database `prefect`, with a password."""

    def __init__(self, folder: Path) -> None:
        super().__init__("postgresql", folder)
        self._binaries = _installed()
        template, self.password = _empty_cluster()
        self._data = template.parent / f"data{self.port}"
        _as_owner(["cp", "-a", str(template), str(self._data)])
        self.url = self.address("prefect")

    def address(self, database: str) -> str:
        """Where Prefect finds a database of this cluster."""
        return f"postgresql+asyncpg://{ROLE}:{self.password}@127.0.0.1:{self.port}/{database}"

    def command(self) -> list[str]:
        """The postmaster. Without fsync: a killed process loses nothing that it wrote, only a lost machine would."""
        settings = {"listen_addresses": "127.0.0.1", "port": self.port, "unix_socket_directories": "", "fsync": "off",
                    "max_connections": 200}  # fmt: skip
        given = [part for name, value in settings.items() for part in ("-c", f"{name}={value}")]
        return [*_owner_prefix(), str(self._binaries / "postgres"), "-D", str(self._data), *given]

    def answers(self) -> bool:
        """Whether it takes queries: after a kill it recovers first."""
        ready = [str(self._binaries / "pg_isready"), "-q", "-h", "127.0.0.1", "-p", str(self.port)]
        return subprocess.run(ready, check=False).returncode == 0

    def stop(self, polite: signal.Signals = signal.SIGINT, seconds: float = 20) -> None:
        """Fast shutdown: connections are ended, what was committed is written."""
        super().stop(polite, seconds)

    def query(self, sql: str, database: str = "prefect") -> list[list[str]]:
        """Rows that psql gives, values as text.

        Raises:
            RuntimeError: PostgreSQL refused the query.
        """
        said = self._client("psql", "-X", "-q", "-At", "-F", "\x1f", "-R", "\x1e", "-v", "ON_ERROR_STOP=1", "-d", database, "-c", sql)
        return [row.split("\x1f") for row in said.decode().rstrip("\n").split("\x1e") if row]

    def recreate(self, database: str = "prefect") -> None:
        """Drop a database, also under connected clients, and make it anew, empty."""
        self.query(f'DROP DATABASE IF EXISTS "{database}" WITH (FORCE)', "postgres")
        self.query(f'CREATE DATABASE "{database}"', "postgres")

    def dump(self, database: str = "prefect") -> bytes:
        """All of a database as SQL text, by pg_dump."""
        return self._client("pg_dump", "--inserts", "-d", database)

    def _client(self, program: str, *arguments: str) -> bytes:
        command = [str(self._binaries / program), "-h", "127.0.0.1", "-p", str(self.port), "-U", ROLE, "-w", *arguments]
        done = subprocess.run(command, env={**os.environ, "PGPASSWORD": self.password}, capture_output=True, check=False)
        if done.returncode:
            raise RuntimeError(done.stderr.decode(errors="replace"))
        return done.stdout

    def remove(self) -> None:
        """Take the data away; the service does not run any more."""
        shutil.rmtree(self._data)


class PrefectServer(Service):
    """A Prefect server on a database; `url` is what PREFECT_API_URL wants, `access` are all variables that lead to it.

    `header` is what a request must bring along.
    """

    def __init__(self, folder: Path, database_url: str | None, settings: Mapping[str, str]) -> None:
        super().__init__("prefect", folder)
        home = folder / "prefect"
        home.mkdir(exist_ok=True)
        if database_url is None:
            have_been_started(home)
        self.url = f"http://127.0.0.1:{self.port}/api"
        self.token = settings.get(SERVER_TOKEN) or new_token()
        self.access = {"PREFECT_API_URL": self.url, CLIENT_TOKEN: self.token}
        self.header = {"Authorization": f"Basic {base64.b64encode(self.token.encode()).decode()}"}
        self.environment = {
            SERVER_TOKEN: self.token,
            "PREFECT_HOME": str(home),
            "PREFECT_API_DATABASE_CONNECTION_URL": database_url or f"sqlite+aiosqlite:///{home}/prefect.db",
            "PREFECT_SERVER_UI_API_URL": self.url,
            "PREFECT_SERVER_LOGGING_LEVEL": "WARNING",
            "DO_NOT_TRACK": "1",
            "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
            **settings,
        }

    def command(self) -> list[str]:
        """As its administrator starts it."""
        return [sys.executable, "-m", "flows.server", "--port", str(self.port)]

    def answers(self) -> bool:
        """Whether the API says that it is well."""
        return is_healthy(self.url)


class S3(Service):
    """moto's S3 server. It keeps objects in memory: they are gone with the process."""

    def __init__(self, folder: Path) -> None:
        super().__init__("moto", folder)
        self.url = f"http://127.0.0.1:{self.port}"
        self.access = {
            "AWS_ENDPOINT_URL": self.url, "AWS_ACCESS_KEY_ID": "testing", "AWS_SECRET_ACCESS_KEY": "testing",
            "AWS_DEFAULT_REGION": "us-east-1", "AWS_EC2_METADATA_DISABLED": "true",
        }  # fmt: skip

    def command(self) -> list[str]:
        """moto as a process of its own."""
        return [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(self.port)]

    def make_bucket(self, name: str) -> None:
        """An empty bucket."""
        self.client.create_bucket(Bucket=name)

    def make_object(self, name: str, data: bytes) -> None:
        """An object `bucket/key`; the bucket is there."""
        bucket, _, key = name.partition("/")
        self.client.put_object(Bucket=bucket, Key=key, Body=data)

    def objects(self, prefix: str) -> dict[str, bytes]:
        """Every object below `bucket/prefix` with its bytes, by name."""
        bucket = prefix.partition("/")[0]
        return {f"{bucket}/{key}": self.client.get_object(Bucket=bucket, Key=key)["Body"].read() for key in self._keys(prefix)}

    def remove(self, prefix: str) -> None:
        """Remove every object below `bucket/prefix`."""
        for key in self._keys(prefix):
            self.client.delete_object(Bucket=prefix.partition("/")[0], Key=key)

    def _keys(self, prefix: str) -> list[str]:
        bucket, _, folder = prefix.partition("/")
        pages = self.client.get_paginator("list_objects_v2").paginate(Bucket=bucket, Prefix=f"{folder}/" if folder else "")
        return [row["Key"] for page in pages for row in page.get("Contents", [])]

    @cached_property
    def client(self) -> Any:
        """Amazon's own client of this server."""
        import boto3

        return boto3.client(
            "s3", endpoint_url=self.url, region_name="us-east-1",
            aws_access_key_id=self.access["AWS_ACCESS_KEY_ID"], aws_secret_access_key=self.access["AWS_SECRET_ACCESS_KEY"],
        )  # fmt: skip


@contextlib.contextmanager
def postgres_server(folder: Path) -> Iterator[Postgres]:
    """A new PostgreSQL cluster with an empty database `prefect`; its log lies in `folder`. Skips where none is installed."""
    if postgres_binaries() is None:
        import pytest

        pytest.skip("PostgreSQL is not installed: apt-get install postgresql")
    service = Postgres(folder)
    try:
        service.start()
        service.recreate()
        yield service
    finally:
        service.stop()
        service.remove()


@contextlib.contextmanager
def prefect_server_process(folder: Path, database_url: str | None = None, **settings: str) -> Iterator[PrefectServer]:
    """A Prefect server on a database, by default on SQLite in `folder`; `settings` are further PREFECT_ variables."""
    service = PrefectServer(folder, database_url, settings)
    try:
        service.start()
        yield service
    finally:
        service.stop()


@cache
def _migrated_database() -> Path:
    """SQLite as a first start of Prefect's server leaves it. It is kept beside pytest's own cache, for as long as Prefect is the same."""
    kept = REPOSITORY / ".pytest_cache" / f"prefect-{metadata.version('prefect')}.db"
    if not kept.exists():
        with tempfile.TemporaryDirectory(prefix="metascenes-prefect-") as folder:
            made = Path(folder) / "prefect.db"
            surroundings = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
            surroundings |= {"PREFECT_HOME": folder, "PREFECT_API_DATABASE_CONNECTION_URL": f"sqlite+aiosqlite:///{made}"}
            command = [sys.executable, "-m", "prefect", "server", "database", "upgrade", "-y"]
            done = subprocess.run(command, env=surroundings, capture_output=True, text=True, check=False)
            if done.returncode:
                raise RuntimeError(f"{' '.join(command)}: {done.stdout}{done.stderr}")
            with contextlib.closing(sqlite3.connect(made)) as database:
                database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            kept.parent.mkdir(exist_ok=True)
            meanwhile = kept.with_name(f"{kept.name}.{os.getpid()}")
            shutil.copyfile(made, meanwhile)
            meanwhile.replace(kept)
    return kept


def have_been_started(home: Path) -> Path:
    """Give a PREFECT_HOME that is new the database of one in which a server ran before: the first start takes several times as long."""
    home.mkdir(parents=True, exist_ok=True)
    if not (home / "prefect.db").exists():
        shutil.copyfile(_migrated_database(), home / "prefect.db")
    return home


@contextlib.contextmanager
def s3_server(folder: Path | None = None) -> Iterator[S3]:
    """moto's S3 server, empty; `access` are the variables that lead to it. Skips where moto is not installed."""
    import pytest

    for package in ("moto", "obstore", "flask"):
        pytest.importorskip(package)
    with tempfile.TemporaryDirectory(prefix="metascenes-s3-") as own:
        service = S3(folder or Path(own))
        try:
            service.start()
            yield service
        finally:
            service.kill()


@contextlib.contextmanager
def environment_of(s3: S3) -> Iterator[None]:
    """This process and its children reach S3 at this server, and nowhere else."""
    import pytest

    elsewhere = ("AWS_PROFILE", "AWS_SESSION_TOKEN", "AWS_ENDPOINT_URL_S3", "HTTP_PROXY", "http_proxy", "ALL_PROXY", "all_proxy")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in s3.access.items():
            patch.setenv(name, value)
        for name in elsewhere:
            patch.delenv(name, raising=False)
        yield


def free_port() -> int:
    """A port of the loopback on which nobody listens."""
    draw = random.SystemRandom()
    while True:
        port = draw.choice(PORTS)
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port


@cache
def postgres_binaries() -> Path | None:
    """Folder of the newest PostgreSQL's programs, as Debian installs them, else of those on the path; None without any."""
    debian = [path.parent for path in Path("/usr/lib/postgresql").glob("*/bin/postgres") if re.fullmatch(r"\d+", path.parent.parent.name)]
    if debian:
        return max(debian, key=lambda folder: int(folder.parent.name))
    found = shutil.which("initdb")
    return Path(found).resolve().parent if found and shutil.which("postgres") else None


def _installed() -> Path:
    found = postgres_binaries()
    if found is None:
        raise RuntimeError("PostgreSQL is not installed: apt-get install postgresql")
    return found


@cache
def _empty_cluster() -> tuple[Path, str]:
    """A data folder fresh from initdb and its password, made once per test process: every server starts on a copy."""
    # PostgreSQL refuses to be root, and its own user must reach the data: pytest's folders are closed to others.
    home = Path(tempfile.mkdtemp(prefix="metascenes-postgres-"))
    atexit.register(shutil.rmtree, home, ignore_errors=True)
    password = secrets.token_hex(16)
    file = home / "password"
    file.write_text(password)
    if _owner_prefix():
        for path in (home, file):
            shutil.chown(path, "postgres", "postgres")
    _as_owner(
        [str(_installed() / "initdb"), "-D", str(home / "template"), "-U", ROLE, "-A", "scram-sha-256", f"--pwfile={file}",
         "-E", "UTF8", "--locale=C.UTF-8", "--no-sync", "--wal-segsize=1", "--no-instructions"]
    )  # fmt: skip
    return home / "template", password


def _owner_prefix() -> list[str]:
    """How to become the user that owns the cluster: Debian's `postgres` for root, who may not; nothing for others."""
    if os.geteuid() != 0:
        return []
    user = pwd.getpwnam("postgres")
    return ["setpriv", "--reuid", str(user.pw_uid), "--regid", str(user.pw_gid), "--clear-groups", "--"]


def _as_owner(command: list[str]) -> None:
    done = subprocess.run([*_owner_prefix(), *command], cwd="/", capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr}")


def _kill_below(parent: psutil.Process) -> None:
    """SIGKILL to all descendants, until there are none. Orphans come up to `parent`, which is a subreaper."""
    while True:
        living = []
        with contextlib.suppress(psutil.NoSuchProcess):
            living = [child for child in parent.children(recursive=True) if child.status() != psutil.STATUS_ZOMBIE]
        if not living:
            return
        for child in living:
            with contextlib.suppress(psutil.NoSuchProcess):
                child.kill()
        time.sleep(0.01)
