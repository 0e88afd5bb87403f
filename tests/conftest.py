"""What tests share: where real data lies, and how a skip says why."""

from __future__ import annotations

import fcntl
import gc
import os
import shutil
import signal
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

REPOSITORY = Path(__file__).resolve().parent.parent

os.environ.setdefault("DO_NOT_TRACK", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes import the project: compiling it takes each of them a second
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # so starts a shell what it runs in the background, and processes of ours would, too
    signal.signal(signal.SIGINT, signal.default_int_handler)

# `make test` draws the same examples every time, so that what it says is about the change; `make test-all` draws new ones.
# No example has a time limit: on a busy machine any takes a second now and then, and a clock says nothing about the code.
settings.register_profile("new", deadline=None)
settings.register_profile("same", deadline=None, derandomize=True)
settings.load_profile("new")


@pytest.fixture(scope="session")
def realdata() -> Callable[[str], Path]:
    """Path of a folder of real data by others, or a skip that says why.

    The data is never in the repository. METASCENES_REALDATA names its folder; without it,
    `shared/realdata` beside the repository is looked at.
    """
    root = Path(os.environ.get("METASCENES_REALDATA") or REPOSITORY.parent / "shared" / "realdata")

    def find(name: str) -> Path:
        path = root / name
        if not path.exists():
            pytest.skip(f"real data {name!r} is not in {root}; set METASCENES_REALDATA to the folder that holds it")
        return path

    return find


@pytest.fixture
def own_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine of the test's own: Prefect's home, cache and temporary files lie below the folder that this gives."""
    machine = tmp_path / "machine"
    (machine / "tmp").mkdir(parents=True)
    monkeypatch.setenv("PREFECT_HOME", str(machine / "prefect"))
    monkeypatch.setenv("METASCENES_CACHE", str(machine / "cache"))
    monkeypatch.setenv("TMPDIR", str(machine / "tmp"))
    monkeypatch.setattr(tempfile, "tempdir", str(machine / "tmp"))
    return machine


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """The folder `name`, which `make` fills where no process of this test run has; nobody may change what is in it."""
    base = factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    folder, done = shared / name, shared / f"{name}.done"
    with (shared / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)  # of a process that died in it
            folder.mkdir()
            make(folder)
            done.touch()
    return folder


def pytest_collection_finish() -> None:
    """Imported modules and collected tests stay until the end: the garbage collector need not look at them again and again."""
    gc.collect()
    gc.freeze()


_skipped: list[str] = []


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.skipped and not hasattr(report, "wasxfail"):
        _skipped.append(f"{report.nodeid}: {report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr}")


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Where everything that tests need is installed (METASCENES_SKIPS_FAIL), a skipped test is a failed run."""
    if os.environ.get("METASCENES_SKIPS_FAIL") and _skipped and not hasattr(session.config, "workerinput") and exitstatus == 0:
        session.exitstatus = 1


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if os.environ.get("METASCENES_SKIPS_FAIL") and _skipped:
        terminalreporter.section("skipped where nothing may be skipped", red=True)
        for line in _skipped:
            terminalreporter.line(line)
