"""The public workflow does what `.ci/run` does, for every Python that the project allows. It also runs the slow tests, with Open3D."""

from __future__ import annotations

import re
import tomllib
from typing import Any

import yaml

from tests.conftest import REPOSITORY

WORKFLOW: dict[str, Any] = yaml.safe_load((REPOSITORY / ".github" / "workflows" / "ci.yml").read_text())
JOB: dict[str, Any] = WORKFLOW["jobs"]["test"]
OWN = (REPOSITORY / ".ci" / "run").read_text()
STEPS = [step["run"] for step in JOB["steps"] if "run" in step]


def test_the_same_packages_are_installed() -> None:
    """The install line has Open3D's libraries besides, for the slow tests. Both keep Debian from making a cluster of its own."""
    (installed,) = re.findall(r"apt-get install .*--no-install-recommends (chromium .*)", STEPS[0])
    (open3d,) = re.findall(r"^open3d:.* wants Debian's (.*)\.$", (REPOSITORY / "Makefile").read_text(), re.MULTILINE)
    assert set(installed.split()) == set(re.findall(r"missing\+=\((.*?)\)", OWN)) | set(open3d.split(", "))
    for line in re.findall(r"echo .*createcluster\.conf", OWN):
        assert line in STEPS[0]
    assert "postgresql-common" in STEPS[0]


def test_the_same_commands_are_run_in_the_same_order() -> None:
    made = [target for line in re.findall(r"^make (.*)$", OWN, re.MULTILINE) for target in line.split()]
    run = [target for step in STEPS for line in re.findall(r"^make (.*)$", step, re.MULTILINE) for target in line.split()]
    assert [target for target in run if target in made] == made
    assert run[-1] == "test-all"
    assert "open3d" in run
    for name, value in re.findall(r"^export (METASCENES_\w+)=(\S+)$", OWN, re.MULTILINE):
        assert JOB["env"][name] == value


def test_every_python_that_the_project_allows_is_tried() -> None:
    allowed = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["requires-python"]
    first, last = map(int, re.fullmatch(r">=3\.(\d+),<3\.(\d+)", allowed).groups())
    pythons = [f"3.{minor}" for minor in range(first, last)]
    assert JOB["strategy"]["matrix"]["python"] == pythons
    (slow,) = [step for step in JOB["steps"] if step.get("run") == "make test-all"]
    assert slow["if"].removeprefix("matrix.python == ").strip("'") in pythons
    makefile = (REPOSITORY / "Makefile").read_text()
    assert f"(3, {first}) <= sys.version_info < (3, {last})" in makefile


def test_actions_are_pinned_and_nothing_is_secret() -> None:
    used = [step["uses"] for step in JOB["steps"] if "uses" in step]
    assert used
    assert all(re.fullmatch(r"[\w/-]+@[0-9a-f]{40}", action) for action in used)
    text = (REPOSITORY / ".github" / "workflows" / "ci.yml").read_text()
    assert "secrets" not in text
    assert WORKFLOW["permissions"] == {"contents": "read"}


def test_packages_are_kept_as_long_as_the_lock_files_are_the_same() -> None:
    (kept,) = [step["with"] for step in JOB["steps"] if step.get("uses", "").startswith("actions/cache@")]
    installed = re.findall(r"INSTALL.*-r (requirements/\w+\.lock)", (REPOSITORY / "Makefile").read_text())
    needed = {f"requirements/{name}.lock" for name in ("run", "train", "test")}
    assert needed <= set(installed)
    assert set(re.findall(r"requirements/\w+\.lock", kept["key"])) == needed
    assert kept["path"] == JOB["env"]["PIP_CACHE_DIR"]
