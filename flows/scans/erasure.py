"""What this machine remembers of a scene outside of the lake: cached convex pieces, surfaces, hashes of scan files, and
mirrors of scans that lie in a store."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Collection
from pathlib import Path

from flows.run.fingerprints import PICTURES, cache_folder
from schemas.files import write_whole
from schemas.record import BLOB_PATTERN
from warehouse.upkeep.erasure import Traces


def erase_from_caches(traces: Traces, hashes: Collection[str], folder: Path | None = None) -> int:
    """Remove from the machine's caches what belongs to a scene; how many files and entries went.

    Values that are kept under a blob's name go when the blob went. Keys of others (convex pieces) are hashes that do not
    say whose they are, so that all of these go where anything of the scene was ever kept: they are computed again when
    they are needed. Hashes of scan files go where a path names the scene, and so do mirrors of its scan.
    """
    root = folder or cache_folder()
    gone = set(hashes)
    count = 0
    for path in sorted((root / "modules").glob("*/*")):
        is_blob = re.fullmatch(BLOB_PATTERN, path.name) is not None
        if path.is_file() and (path.name.partition(".")[0] in gone if is_blob else bool(gone) or path.parent.name.startswith(PICTURES)):
            path.unlink(missing_ok=True)
            count += 1
    return count + _erase_mirrors(root / "scans", traces) + _erase_paths(root / "file_hashes.json", traces)


def _erase_mirrors(folder: Path, traces: Traces) -> int:
    """Remove the versions of the scene's scan that were fetched from a store, and the links to them."""
    count = 0
    for facts in sorted(folder.glob("*/versions/*.json")):
        record = json.loads(facts.read_text())
        if any(traces.in_text(str(record.get(name, ""))) for name in ("scene", "scan", "content")):
            facts.unlink(missing_ok=True)
            shutil.rmtree(facts.with_suffix(""), ignore_errors=True)
            count += 1
    for link in folder.glob("*/views/**/*"):
        if link.is_symlink() and not link.exists():
            link.unlink(missing_ok=True)
    return count


def _erase_paths(store: Path, traces: Traces) -> int:
    """Remove the entries of scan files whose paths name the scene."""
    try:
        known = json.loads(store.read_text())
    except (OSError, ValueError):
        return 0
    kept = {path: entry for path, entry in known.items() if not traces.in_text(path)} if isinstance(known, dict) else {}
    if isinstance(known, dict) and len(kept) == len(known):
        return 0
    write_whole(store, json.dumps(kept).encode(), cache=True)
    return len(known) - len(kept)
