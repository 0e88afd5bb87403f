"""Resolve the project's dependencies and pin them: `run.lock` for running it, `test.lock` for what its tests need besides."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent
BUILD = ["editables", "async-timeout"]
"""Needed besides: by hatchling to install the project in place; by redis on Python before 3.11.3."""


def resolve(requirements: list[str]) -> dict[str, str]:
    """Names and versions that pip would install into an empty environment."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed", "--report", str(report)]
        subprocess.run([*command, *requirements], check=True)
        return {item["metadata"]["name"].lower(): item["metadata"]["version"] for item in json.loads(report.read_text())["install"]}


def main() -> None:
    """Write both lock files."""
    project = tomllib.loads((HERE.parent / "pyproject.toml").read_text())
    run = [*project["project"]["dependencies"], *project["build-system"]["requires"], *BUILD]
    pinned = resolve(run)
    everything = resolve(
        [*(f"{name}=={version}" for name, version in pinned.items()), *project["project"]["optional-dependencies"]["test"]]
    )
    extra = {name: version for name, version in everything.items() if name not in pinned}
    for name, pins in (("run", pinned), ("test", extra)):
        lines = [f"{package}=={version}" for package, version in sorted(pins.items())]
        (HERE / f"{name}.lock").write_text("# Written by `make lock`.\n" + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
