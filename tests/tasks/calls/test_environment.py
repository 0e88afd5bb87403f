"""Programs of others receive listed variables of the environment, whoever starts them."""

from __future__ import annotations

import contextlib
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from bench.engines.setups import FOREIGN, _interpreter
from bench.policy import renderers
from schemas.errors import InputError
from schemas.machine.environment import KEPT_VARIABLES, child_environment
from tasks.calls.command import CommandFailed, run_apart, run_command
from tasks.candidates.commanded import Commanded, made
from tasks.candidates.generation.generated import GeneratorInput
from tasks.capture.poses.open3d import Open3DPoses
from tasks.capture.small_objects.detectors.commanded import CommandDetector, CommandedDetector
from tasks.geometry.meshes import dump_glb
from tasks.library import confinement
from tasks.optimization.engines import newton_engine
from tasks.optimization.engines.newton_engine import Newton
from tasks.texturing.commanded import TextureCommand, painted
from tasks.texturing.unwrapping import SmartUvUnwrapper, unwrapped
from tests.conftest import REPOSITORY

SECRETS = {
    "PREFECT_API_AUTH_STRING": "secret-1",
    "PREFECT_SERVER_API_AUTH_STRING": "secret-2",
    "PREFECT_API_DATABASE_CONNECTION_URL": "postgresql+asyncpg://prefect:secret-3@db/prefect",
    "PREFECT_SERVER_ENCRYPTION_KEY": "secret-4",
    "METASCENES_NOTIFY_URL": "https://hooks.slack.com/services/secret-5",
    "http_proxy": "http://me:secret-6@proxy:3128",
    "HTTPS_PROXY": "http://me:secret-7@proxy:3128",
    "all_proxy": "socks5://me:secret-8@proxy:1080",
    "SSH_AUTH_SOCK": "/run/secret-9",
    "AWS_ACCESS_KEY_ID": "secret-10",
    "AWS_SECRET_ACCESS_KEY": "secret-11",
    "AWS_SESSION_TOKEN": "secret-12",
    "AWS_ENDPOINT_URL": "http://me:secret-13@store:8333",
    "HF_TOKEN": "secret-14",
    "OPENAI_API_KEY": "secret-15",
    "MY_STUFF": "secret",
    "PYTHONPATH": "/secret",
    "PYTHONSTARTUP": "/secret",
    "LD_PRELOAD": "",
    "KRB5CCNAME": "/tmp/secret",
    "DBUS_SESSION_BUS_ADDRESS": "unix:path=/secret",
    "path": "secret",
}
"""Variables of a parent that no program of others receives."""

HARMLESS = {
    name: f"{name.lower()}-value" for name in KEPT_VARIABLES if name not in {"PATH", "HOME", "TMPDIR"} and "_LIBRARY_PATH" not in name
}

QUAD = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0.5], [0, 1, 0.5]]), np.array([[0, 1, 2], [0, 2, 3]])


def _generates(program: Path) -> None:
    made(GeneratorInput("a chair", b"", 0), Commanded(command=f"{program} {{prompt}} {{out}}"), lambda: None)


def _detects(program: Path) -> None:
    picture = np.zeros((4, 4, 3), dtype=np.uint8)
    CommandDetector(CommandedDetector(command=f"{program} {{image}} {{out}}")).detect([picture], ["mug"])


def _paints(program: Path) -> None:
    box = trimesh.creation.box()
    painted(TextureCommand(words=(str(program), "{mesh}", "{out}")), dump_glb([box], ["box"]))


def _unwraps(program: Path) -> None:
    unwrapped(SmartUvUnwrapper(program=str(program)), *QUAD)


def _poses(program: Path) -> None:
    Open3DPoses(python=str(program)).problem()


def _simulates(program: Path) -> None:
    newton_engine._run(Newton(python=str(program)), program.parent / "scene.npz", program.parent / "settled.npz")


def _is_looked_for(program: Path) -> None:
    _interpreter(FOREIGN[0], str(program))


def _draws(program: Path) -> None:
    renderers._drawn(str(program), renderers.PYRENDER_SCRIPT, "PYOPENGL_PLATFORM", program, renderers.RenderRequest([], [], 90.0, 1.0))


CHILDREN: dict[str, tuple[Callable[[Path], Any], set[str]]] = {
    "a program": (lambda program: run_command([str(program)], program.parent, 600.0), set()),
    "generator": (_generates, set()),
    "detector": (_detects, set()),
    "painter": (_paints, set()),
    "Smart UV": (_unwraps, set()),
    "Open3D": (_poses, set()),
    "Newton": (_simulates, set()),
    "engine of the benchmark": (_is_looked_for, set()),
    "renderer of the benchmark": (_draws, {"PYOPENGL_PLATFORM", "LIBGL_ALWAYS_SOFTWARE", "LP_NUM_THREADS"}),
}
"""Whoever starts a program, and the variables that they add."""


@pytest.fixture
def _attacked(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (SECRETS | HARMLESS).items():
        monkeypatch.setenv(name, value)


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="only Linux shows a process its first environment")
@pytest.mark.usefixtures("_attacked")
@pytest.mark.parametrize("child", CHILDREN)
def test_listed_variables_alone_arrive(child: str, tmp_path: Path) -> None:
    start, more = CHILDREN[child]
    program, told = tmp_path / "program", tmp_path / "told"
    program.write_text(f"#!/bin/sh\ncat < /proc/$$/environ > '{told}'\nexit 1\n")
    program.chmod(0o755)
    with contextlib.suppress(InputError, CommandFailed):
        start(program)
    _check(told.read_text(), more)


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="only Linux shows a process its first environment")
@pytest.mark.usefixtures("_attacked")
def test_the_reader_of_foreign_models_is_told_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told, model = tmp_path / "told", tmp_path / "a.usda"
    model.write_text("")
    monkeypatch.setattr(confinement, "CODE", f"open({str(told)!r}, 'wb').write(open('/proc/self/environ', 'rb').read())")
    with pytest.raises(InputError):
        confinement.confined("read", model, tmp_path, "a.usda")
    _check(
        told.read_text().replace(f"PYTHONPATH={os.pathsep.join(place or os.getcwd() for place in sys.path)}", ""),
        {"PXR_WORK_THREAD_LIMIT", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"},
    )


def _check(text: str, more: set[str]) -> None:
    """The variables that arrived are those that are listed, with their values."""
    arrived = dict(line.split("=", 1) for line in text.split("\0") if line)
    assert set(arrived) <= set(KEPT_VARIABLES) | more
    assert "secret" not in text
    passed_on = {name: value for name, value in HARMLESS.items() if name not in more}
    assert {name: arrived.get(name) for name in passed_on} == passed_on
    assert arrived["PATH"] == os.environ["PATH"]


def test_what_is_added_is_added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MY_STUFF", "secret")
    code = 'import os, sys; sys.exit(f\'{os.environ.get("MY_STUFF")} {os.environ["SEED"]} {os.environ["PATH"]}\')'
    ending = run_apart([sys.executable, "-c", code], tmp_path, 600.0, {"SEED": "7", "PATH": "/bin"})
    assert ending.errors == "None 7 /bin"
    assert "MY_STUFF" not in child_environment()


def test_the_documents_list_the_variables() -> None:
    text = (REPOSITORY / "SECURITY.md").read_text()
    (line,) = re.findall(r"^Programs of others receive these variables .*$", text, re.MULTILINE)
    assert tuple(re.findall(r"`(\w+)`", line)) == KEPT_VARIABLES


def test_no_child_process_is_started_without_its_environment() -> None:
    """Each module that starts processes is known, with the reason for the environment that it passes on."""
    known = {
        "tasks/calls/command.py": "programs of others: listed variables",
        "flows/server/deployments.py": "our own Python, and Prefect",
        "flows/server/process.py": "our own server",
        "flows/server/services.py": "our own server, and Prefect's worker",
    }
    found = {
        path.relative_to(REPOSITORY).as_posix()
        for room in ("schemas", "tasks", "warehouse", "flows")
        for path in (REPOSITORY / room).rglob("*.py")
        if re.search(
            r"\bsubprocess\.(run|Popen|call|check_\w+)\(|\bos\.(system|popen|spawn\w+|posix_spawnp?)\(|create_subprocess", path.read_text()
        )
    }
    assert found == set(known)
