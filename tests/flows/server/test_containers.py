"""`compose.yaml` and `Dockerfile`, as far as they can be held against the project without Docker."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from flows.server.access import CLIENT_TOKEN, SERVER_TOKEN, own_origins
from flows.server.services import SERVER
from tests.conftest import REPOSITORY
from tests.flows.server.test_services import surroundings
from tests.services import s3_server


def compose() -> dict[str, Any]:
    """The file for Docker, with YAML's own references resolved."""
    import yaml

    found: dict[str, Any] = yaml.safe_load((REPOSITORY / "compose.yaml").read_text())
    return found


def test_containers_are_published_to_this_machine_alone_and_hold_no_secret() -> None:
    told = set()
    for name, service in compose()["services"].items():
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", ())), name
        assert re.search(r":\d+(\.\d+)*$", service["image"]) or "build" in service, f"{name}: an image of no version"
        for variable, value in service["environment"].items():
            if re.search("PASSWORD|SECRET|ACCESS_KEY|ENCRYPTION_KEY|AUTH_STRING|CONNECTION_URL", variable):
                assert re.search(r"\$\{\w+:\?", value), f"{name}: {variable} is not taken from .env"
        told |= set(re.findall(r"\$\{(\w+)", json.dumps(service)))
        for needed, how in service.get("depends_on", {}).items():
            other = compose()["services"][needed]
            assert ("healthcheck" in other) == (how["condition"] == "service_healthy"), f"{name}: {needed}"
            assert (other["restart"] == "no") == (how["condition"] == "service_completed_successfully"), f"{name}: {needed}"
    lines = [line for line in (REPOSITORY / ".env.example").read_text().splitlines() if line and not line.startswith("#")]
    assert {line.removesuffix("=") for line in lines} == told, "every variable is in the example, without a value"
    ignored = subprocess.run(["git", "check-ignore", "-q", ".env"], cwd=REPOSITORY)
    assert ignored.returncode in (0, 128), "a file of secrets stays out of the repository"


def test_servers_of_others_are_told_what_ours_are_told() -> None:
    page = (REPOSITORY / "docs" / "services.md").read_text()
    quiet = ("DO_NOT_TRACK", "PREFECT_SERVER_ANALYTICS_ENABLED", "PREFECT_SERVER_UI_V2_ENABLED", "PREFECT_SERVER_CONCURRENCY_LEASE_STORAGE")
    for name in quiet:
        assert compose()["services"]["prefect"]["environment"][name] == SERVER[name]
        assert f"\n{name}={SERVER[name]}\n" in page


def test_the_server_and_those_who_ask_it_have_one_token_and_one_name_for_it() -> None:
    services = compose()["services"]
    server = services["prefect"]["environment"]
    origins = own_origins(4200, {name: value for name, value in server.items() if "${" not in value})
    for name in ("deploy", "worker"):
        told = services[name]["environment"]
        assert told[CLIENT_TOKEN] == server[SERVER_TOKEN]
        assert told["PREFECT_API_URL"].removesuffix("/api") in origins
        assert told["PREFECT_UI_URL"] in origins


def test_links_lead_where_people_reach_the_server() -> None:
    services = compose()["services"]
    address = services["deploy"]["environment"]["PREFECT_UI_URL"]
    assert f"{address.removeprefix('http://')}:{services['prefect']['command'].split()[-1]}" in services["prefect"]["ports"]


@pytest.mark.whole
@pytest.mark.s3
def test_what_our_containers_run_is_there(tmp_path: Path) -> None:
    """The commands of our image as this installation has them, in the environment that the containers have."""
    services = compose()["services"]
    assert {name for name, service in services.items() if "build" in service} == {"prefect", "bucket", "deploy", "worker"}
    environment = surroundings(tmp_path / "home") | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    told = environment | {name: value for name, value in services["deploy"]["environment"].items() if "${" not in value}
    planned = subprocess.run([*services["deploy"]["command"].split(), "--dry-run", "--json"], env=told, capture_output=True, text=True)
    assert planned.returncode == 0, planned.stderr
    pool = json.loads(planned.stdout)["pool"]
    assert f"--pool {pool} " in services["worker"]["command"] + " "
    for name in ("prefect", "worker"):
        program, group, verb, *options = services[name]["command"].split()
        said = subprocess.run([program, group, verb, "--help"], env=environment, cwd=REPOSITORY, capture_output=True, text=True)
        assert said.returncode == 0, said.stderr
        assert [option for option in options if option.startswith("--") and option not in said.stdout] == []
    with s3_server(tmp_path) as s3:
        command = [sys.executable, *services["bucket"]["command"][1:]]
        for _ in range(2):
            subprocess.run(command, env=environment | s3.access, check=True)
        s3.make_object(f"{told['METASCENES_LAKE'].removeprefix('s3://')}/probe", b"there")


def test_the_image_is_made_of_what_the_repository_has() -> None:
    copied = [line.split()[1:-1] for line in (REPOSITORY / "Dockerfile").read_text().splitlines() if line.startswith("COPY")]
    sources = [source for line in copied for source in line]
    assert len(sources) > 6
    kept = [line[1:] for line in (REPOSITORY / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    for source in sources:
        assert (REPOSITORY / source).exists(), source
        assert any(Path(source).match(pattern) for pattern in kept), f"{source} is left out by .dockerignore"
    packed = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert {*packed["packages"], *packed["force-include"]} <= set(sources)
