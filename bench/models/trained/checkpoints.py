"""Where a training of the network goes on from, and a second measurement takes it from: the cache, for the code that it follows from."""

from __future__ import annotations

import hashlib
from pathlib import Path

from flows.run.fingerprints import FileCache, cache_folder, code_fingerprint, digest

MODULES = ("channels", "fitting", "grouping", "networks/parting", "noise", "scenes", "things")
"""Of this folder, that weights follow from."""

ELSEWHERE = ("tasks.capture.small_objects.classical", "tasks.furniture", "tasks.scanner.scenery", "tasks.training.fitting")
"""Modules that these build on, with all that those import."""


def checkpoints() -> FileCache:
    """Checkpoints by name; others once the code is another."""
    folder = Path(__file__).parent
    sources = [hashlib.sha256((folder / f"{name}.py").read_bytes()).hexdigest() for name in MODULES]
    return FileCache(cache_folder() / "trained" / digest(*sources, *map(code_fingerprint, ELSEWHERE))[:16])
