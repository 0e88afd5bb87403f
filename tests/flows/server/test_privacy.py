"""Nothing leaves the machine unasked, no secret is written down anywhere, and servers of ours listen on the loopback alone."""

from __future__ import annotations

import base64
import io
import secrets
import shutil
import signal
import subprocess
import sys
import time
import urllib.parse
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.conftest import REPOSITORY
from tests.flows.server.test_services import QUICK, scan, surroundings
from tests.services import (
    ROLE,
    START_SECONDS,
    environment_of,
    free_port,
    have_been_started,
    postgres_server,
    prefect_server_process,
    s3_server,
)

pytestmark = pytest.mark.whole

Lines = Callable[[], list[str]]
LIMIT = 500
SETTINGS = [part for setting in QUICK for part in ("--set", setting)]


def metascenes(environment: Mapping[str, str], *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "flows.cli", *map(str, arguments)]
    return subprocess.run(command, env=dict(environment), cwd=REPOSITORY, capture_output=True, text=True, timeout=LIMIT)


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What stands before libc and refuses connections to other machines, compiled."""
    if shutil.which("g++") is None:
        pytest.skip("there is no g++ to compile tests/egress.cpp with: apt-get install g++")
    made = tmp_path_factory.mktemp("egress") / "egress.so"
    command = ["g++", "-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o", str(made), str(REPOSITORY / "tests" / "egress.cpp"), "-ldl"]
    subprocess.run(command, check=True)
    return made


@pytest.fixture
def watched(library: Path, tmp_path: Path) -> tuple[dict[str, str], Lines]:
    """The environment of somebody who has set nothing, in which every attempt to leave the machine is refused, and the attempts."""
    seen = tmp_path / "egress.txt"
    environment = surroundings(tmp_path / "home") | {"LD_PRELOAD": str(library), "METASCENES_TEST_EGRESS": str(seen)}
    environment.pop("CI", None)  # Prefect sends nothing from there, whatever it is told
    return environment, lambda: seen.read_text().splitlines() if seen.exists() else []


def test_a_run_and_its_server_reach_for_nothing_but_the_loopback(watched: tuple[dict[str, str], Lines], tmp_path: Path) -> None:
    environment, seen = watched
    scan(tmp_path / "scans", 0)
    done = metascenes(environment, "run", "--scans", tmp_path / "scans", "--lake", tmp_path / "lake", "--workers", 1, *SETTINGS)
    assert done.returncode == 0, done.stderr
    for command in (["status"], ["sql", "SELECT count(*) AS n FROM instances"]):
        done = metascenes(environment, *command, "--lake", tmp_path / "lake")
        assert done.returncode == 0, done.stderr
    assert seen() == []


SERVES = """
import sys, time
from flows.server.process import prefect_server
with prefect_server() as address:
    print(address, flush=True)
    sys.stdin.read()
"""


def test_a_server_with_its_telemetry_on_is_seen_reaching_out(watched: tuple[dict[str, str], Lines]) -> None:
    """The check above can fail: what is set by a user stays as it is, and then the server calls its makers."""
    environment, seen = watched
    environment |= {"DO_NOT_TRACK": "0", "PREFECT_SERVER_ANALYTICS_ENABLED": "true"}
    have_been_started(Path(environment["HOME"]) / ".prefect")
    for _ in range(3):  # a server whose database is busy when it would call does so ten minutes later
        with subprocess.Popen([sys.executable, "-c", SERVES], env=environment, cwd=REPOSITORY, stdin=subprocess.PIPE) as process:
            give_up = time.monotonic() + START_SECONDS
            while not seen() and time.monotonic() < give_up:
                time.sleep(0.1)
            process.communicate()
        if seen():
            break
    assert any(line.endswith("prefect.io") for line in seen())


REACHES = """
import multiprocessing, socket
from contextlib import suppress
def other():
    with suppress(OSError): socket.create_connection(("192.0.2.1", 80), 5)
if __name__ == "__main__":
    child = multiprocessing.get_context("spawn").Process(target=other)
    child.start(); child.join()
    with suppress(OSError): socket.getaddrinfo("example.org", 80)
    with suppress(OSError): socket.socket(socket.AF_INET6, socket.SOCK_DGRAM).sendto(b"x", ("2001:db8::1", 53))
    socket.create_server(("127.0.0.1", 0)).close()
    import deltalake
    access = {"aws_endpoint_url": "http://192.0.2.7:9", "aws_allow_http": "true", "aws_access_key_id": "x", "aws_secret_access_key": "x",
              "aws_region": "x", "max_retries": "0", "connect_timeout": "2s", "timeout": "2s"}
    with suppress(Exception): deltalake.DeltaTable("s3://bucket/table", storage_options=access)
"""


def test_the_watch_sees_children_names_datagrams_and_native_code(watched: tuple[dict[str, str], Lines], tmp_path: Path) -> None:
    environment, seen = watched
    (tmp_path / "reaches.py").write_text(REACHES)
    done = subprocess.run([sys.executable, str(tmp_path / "reaches.py")], env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert {"connect 192.0.2.1", "getaddrinfo example.org", "sendto 2001:db8::1", "connect 192.0.2.7"} <= set(seen())


def plain(data: bytes) -> bytes:
    """Bytes with what is packed in them: the columns of a Parquet file, the members of an archive."""
    if data[:4] == b"PAR1":
        return data + repr(pq.read_table(io.BytesIO(data)).to_pydict()).encode()
    if data[:4] == b"PK\x03\x04":
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return data + b"".join(archive.read(name) for name in archive.namelist())
    return data


def found(words: Mapping[str, str], places: Mapping[str, bytes]) -> set[tuple[str, str]]:
    """Which word stands where: as it is, quoted as in an address, or in base 64."""
    hits = set()
    for place, data in places.items():
        text = plain(data)
        for name, word in words.items():
            forms = {word.encode(), urllib.parse.quote(word, safe="").encode(), base64.b64encode(word.encode())}
            if any(form in text for form in forms):
                hits.add((name, place))
    return hits


def test_the_search_for_words_reads_what_is_packed() -> None:
    word = secrets.token_urlsafe(18)
    parquet, archive = io.BytesIO(), io.BytesIO()
    pq.write_table(pa.table({"a": [f"x{word}y" * 50]}), parquet, compression="zstd")
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("b", word * 50)
    places = {"parquet": parquet.getvalue(), "zip": archive.getvalue(), "coded": base64.b64encode(word.encode()), "none": b"x" * 99}
    assert found({"word": word}, places) == {("word", "parquet"), ("word", "zip"), ("word", "coded")}


@pytest.mark.slow
@pytest.mark.postgres
@pytest.mark.s3
def test_secrets_of_the_environment_are_written_down_nowhere(tmp_path: Path) -> None:
    """Credentials of S3, of PostgreSQL and of a webhook: in no output, no log, no table of Prefect's, no object of the lake."""
    scan(tmp_path / "scans", 0)
    scan(tmp_path / "scans", 1)
    mesh = next((tmp_path / "scans" / "scene0001_00").glob("*.ply"))
    mesh.write_bytes(mesh.read_bytes()[:5000])
    hook = secrets.token_hex(16)
    with postgres_server(tmp_path) as postgres, s3_server(tmp_path) as s3:
        words = {"key id": f"AKIA{secrets.token_hex(8)}", "key": secrets.token_urlsafe(30), "webhook": hook, "password": postgres.password}
        words["server's key"] = key = base64.urlsafe_b64encode(secrets.token_bytes(32)).decode()
        s3.access |= {"AWS_ACCESS_KEY_ID": words["key id"], "AWS_SECRET_ACCESS_KEY": words["key"]}
        settings = {"PREFECT_SERVER_LOGGING_LEVEL": "DEBUG", "PREFECT_SERVER_ENCRYPTION_KEY": key}
        with environment_of(s3), prefect_server_process(tmp_path, postgres.url, **settings) as prefect:
            s3.make_bucket("lakes")
            words["token"] = prefect.token
            environment = surroundings(tmp_path / "home") | s3.access | {
                **prefect.access, "PREFECT_LOGGING_LEVEL": "DEBUG", "PREFECT_API_DATABASE_CONNECTION_URL": postgres.url,
                "METASCENES_NOTIFY_URL": f"http://127.0.0.1:9/hooks/{hook}",
            }  # fmt: skip
            lake = "s3://lakes/private/lake"
            said = {
                "deploy": metascenes(environment, "deploy", "--scans", tmp_path / "scans", "--lake", lake),
                "run": metascenes(environment, "run", "--scans", tmp_path / "scans", "--lake", lake, "--workers", 1, *SETTINGS),
                "status": metascenes(environment, "status", "--lake", lake),
                "no bucket": metascenes(environment, "run", "--scans", tmp_path / "scans", "--lake", "s3://none/lake", *SETTINGS),
            }
            assert [done.returncode for done in said.values()] == [0, 1, 0, said["no bucket"].returncode], said["deploy"].stderr
            assert said["no bucket"].returncode != 0
            dump = _settled(postgres.dump)
            objects = s3.objects("lakes")
        places = {f"{name} said": (done.stdout + done.stderr).encode() for name, done in said.items()}
        places |= {"database": dump, "server's log": prefect.log.read_bytes()} | objects
        known = {"the failed scan": "scene0001_00", "the address": lake}
        seen = found(known, places)
        assert {("the failed scan", "run said"), ("the failed scan", "database"), ("the address", "database")} <= seen
        assert any(place in objects for _, place in seen), "the search reads the lake"
        assert found(words, places) == set()
        assert b"fernet_key" not in dump, "the key is no neighbor of what it encrypts"


def _settled(dump: Callable[[], bytes]) -> bytes:
    """A dump of a database, once it grows no more: runs are written behind."""
    give_up = time.monotonic() + 60
    before = dump()
    while time.monotonic() < give_up:
        time.sleep(3)
        after = dump()
        if len(after) == len(before):
            break
        before = after
    return before


@pytest.mark.slow
@pytest.mark.parametrize(("place", "reason"), [("127.0.0.1:1", "ConnectionRefusedError"), ("127.0.0.1:port", "ValueError")])
@pytest.mark.parametrize("quoted", [True, False])
def test_a_database_that_is_not_there_is_named_without_its_password(place: str, reason: str, quoted: bool, tmp_path: Path) -> None:
    pieces = secrets.token_hex(6), secrets.token_hex(6)
    password = f"p@{pieces[0]}:/{pieces[1]}"
    last = refused(f"someone:{urllib.parse.quote(password, safe='') if quoted else password}@{place}/prefect", pieces, tmp_path)
    assert not quoted or reason in last


@pytest.mark.postgres
def test_a_wrong_password_is_called_so_and_not_repeated(tmp_path: Path) -> None:
    wrong = secrets.token_hex(16)
    with postgres_server(tmp_path) as postgres:
        last = refused(f"{ROLE}:{wrong}@127.0.0.1:{postgres.port}/prefect", (wrong,), tmp_path)
    assert f'password authentication failed for user "{ROLE}"' in last


def refused(address: str, hidden: Sequence[str], folder: Path) -> str:
    """The one line that says why a server does not start on a database."""
    environment = surroundings(folder / "home") | {"PREFECT_API_DATABASE_CONNECTION_URL": f"postgresql+asyncpg://{address}"}
    done = subprocess.run([sys.executable, "-c", SERVES], env=environment, cwd=REPOSITORY, capture_output=True, text=True, input="")
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert "did not start" in last
    assert "PREFECT_API_DATABASE_CONNECTION_URL" in last
    assert not [piece for piece in hidden if piece in done.stderr]
    return last


def listening(parent: psutil.Process) -> set[str]:
    """The addresses on which a process and all below it listen."""
    everyone = [parent, *parent.children(recursive=True)]
    return {each.laddr.ip for process in everyone for each in process.net_connections("inet") if each.status == psutil.CONN_LISTEN}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["run", "deploy"])
def test_our_servers_listen_on_the_loopback_alone(kind: str, tmp_path: Path) -> None:
    environment = surroundings(tmp_path / "home", started_before=True)
    (tmp_path / "scans").mkdir()
    deploy = ["-m", "flows.cli", "deploy", "--local", "--port", free_port(), "--scans", tmp_path / "scans", "--lake", tmp_path / "lake"]
    command = [sys.executable, *map(str, deploy if kind == "deploy" else ["-c", SERVES])]
    log = tmp_path / "said.txt"
    with log.open("w") as said:
        process = subprocess.Popen(command, env=environment, cwd=REPOSITORY, stdin=subprocess.PIPE, stdout=said, stderr=said)
    try:
        give_up = time.monotonic() + 2 * START_SECONDS
        while ("Ctrl-C" if kind == "deploy" else "/api") not in log.read_text():
            assert process.poll() is None, log.read_text()
            assert time.monotonic() < give_up, log.read_text()
            time.sleep(0.1)
        below = psutil.Process(process.pid).children(recursive=True)
        assert listening(psutil.Process(process.pid)) == {"127.0.0.1"}
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=300)
    psutil.wait_procs(below, timeout=600)
    assert not [each for each in below if each.is_running() and each.status() != psutil.STATUS_ZOMBIE]
