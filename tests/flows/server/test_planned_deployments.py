"""What `metascenes deploy` would set up, refuses and says, without a server; and the file that Prefect's own command reads."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from flows.server import deployments
from flows.server.deployments import FILE_VARIABLES, Schedule, deployment_file, lake_name, planned
from schemas.errors import InputError
from tests.conftest import REPOSITORY
from tests.flows.server.test_deployments import NAMES
from tests.services import free_port

pytestmark = [pytest.mark.whole, pytest.mark.timeout(900)]


def test_every_variable_of_the_file_is_one_that_the_command_sets_and_every_flow_can_be_loaded() -> None:
    from prefect.flows import load_flow_from_entrypoint

    assert set(Schedule("s", "l", "o").environment()) == FILE_VARIABLES
    assert {line.split("$")[1].split(" ")[0] for line in deployment_file().read_text().splitlines() if "{{ $" in line} == FILE_VARIABLES
    for entry in planned(Schedule("s", "l", "o")):
        flow: Any = load_flow_from_entrypoint(entry["entrypoint"])
        assert entry["parameters"].keys() <= flow.parameters.properties.keys(), entry["name"]
        assert "metascenes" in entry["tags"]
    assert {entry["name"] for entry in planned(Schedule("s", "lake", "o"))} == {name.split("/")[1] for name in NAMES}


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--timezone", "Mars/Olympus"], "Mars/Olympus"),
        (["--nightly", "at one"], "at one"),
        (["--weekly", "99 * * * *"], "99 * * * *"),
        (["--pool", ""], "--pool"),
    ],
)
@pytest.mark.parametrize("how", ["--dry-run", "--local"])
def test_what_cannot_be_scheduled_is_one_line_and_exit_code_2_before_a_server_starts(arguments: list[str], named: str, how: str) -> None:
    command = [sys.executable, "-m", "flows.cli", "deploy", "--scans", "s", "--lake", "l", how, *arguments]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stderr
    assert named in done.stderr


def test_without_a_server_or_a_webhook_the_command_says_which_is_missing(tmp_path: Path) -> None:
    plain = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")} | {"PREFECT_HOME": str(tmp_path)}
    command = [sys.executable, "-m", "flows.cli", "deploy", "--scans", "s", "--lake", "l"]
    done = subprocess.run(command, cwd=REPOSITORY, env=plain, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "PREFECT_API_URL" in done.stderr
    assert "--local" in done.stderr


def test_a_server_that_does_not_answer_is_one_line(tmp_path: Path) -> None:
    environment = {**os.environ, "PREFECT_API_URL": f"http://somebody:secret@127.0.0.1:{free_port()}/api", "PREFECT_HOME": str(tmp_path)}
    command = [sys.executable, "-m", "flows.cli", "deploy", "--scans", "s", "--lake", "l"]
    done = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stderr
    assert "no Prefect server answers" in done.stderr
    assert "secret" not in done.stderr


def test_folders_may_have_any_name() -> None:
    entries = {entry["name"].removesuffix("-lake"): entry for entry in planned(Schedule('/scans of "May"\\n: #1', "/lake\t'", "{out}"))}
    assert entries["nightly"]["parameters"]["scans"] == '/scans of "May"\\n: #1'
    assert entries["export"]["parameters"] == {"lake": "/lake\t'", "out": "{out}/exports"}


def test_an_export_into_a_store_is_refused_and_not_written_into_a_folder_of_that_name(tmp_path: Path) -> None:
    from flows.exporting import export

    with pytest.raises(InputError, match="is no folder"):
        export.fn(str(tmp_path / "lake"), "s3://bucket/exports")


def test_a_dry_run_says_what_and_when_and_asks_no_server(tmp_path: Path) -> None:
    environment = {**os.environ, "PREFECT_API_URL": f"http://127.0.0.1:{free_port()}/api", "PREFECT_HOME": str(tmp_path)}
    command = [sys.executable, "-m", "flows.cli", "deploy", "--scans", "s3://b/scans", "--lake", "lake", "--dry-run", "--json"]
    done = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=True)
    entries = {entry["name"].removesuffix("-lake"): entry for entry in json.loads(done.stdout)["deployments"]}
    assert entries["nightly"]["parameters"]["scans"] == "s3://b/scans"
    assert entries["nightly"]["parameters"]["lake"] == str(REPOSITORY / "lake"), "workers run in another folder"


def test_an_installed_package_has_the_file(tmp_path: Path) -> None:
    """The wheel carries it where `deployment_file` looks; in the checkout the root's is used."""
    assert deployment_file() == REPOSITORY / "prefect.yaml"
    import tomllib

    included = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert included == {"prefect.yaml": "flows/prefect.yaml"}
    assert yaml.safe_load(deployment_file().read_text())["deployments"]


@pytest.mark.parametrize(
    ("address", "name"),
    [
        ("/data/Kitchens", "kitchens"),
        ("s3://bucket/my lake/", "my-lake"),
        ("/data/Küche", "kuche-a9ec872e"),
        ("/data/会议室", "hui_yi_shi-423bba6b"),
        ("/data/+", "lake"),
    ],
)
def test_a_lake_in_any_script_has_a_name_of_its_own(address: str, name: str) -> None:
    assert Schedule("/scans", address, "/out").name == lake_name(address) == name


def test_lakes_whose_names_end_alike_are_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    lakes = {"nightly-lake": "/lake", "nightly-my-lake": "/my-lake", "nightly-elsewhere": "/elsewhere"}
    there = {f"replicate/{name}": {"facts": {"parameters": {"lake": lake}}} for name, lake in lakes.items()}
    monkeypatch.setattr("prefect.client.orchestration.get_client", lambda **_: contextlib.nullcontext())
    monkeypatch.setattr(deployments, "_deployments", lambda client: there)
    found = deployments.foreign(Schedule("/scans", "/lake", "/out"))
    assert found == {"/my-lake": ["replicate/nightly-my-lake"], "/elsewhere": ["replicate/nightly-elsewhere"]}


def test_a_name_with_a_placeholder_is_refused() -> None:
    with pytest.raises(InputError, match="--scans"):
        Schedule("{{ prefect.blocks.secret.x }}", "lake", "out")
