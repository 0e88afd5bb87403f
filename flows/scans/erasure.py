"""Erasure from this machine outside of the lake: caches, mirrors of scans that lie in a store, and temporary folders."""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
from collections.abc import Collection
from pathlib import Path

from flows.run.fingerprints import PICTURES, cache_folder
from flows.scans.mirror import facts_of
from schemas.errors import InputError
from schemas.files import write_whole
from schemas.record import BLOB_PATTERN
from tasks.batches import parse_json
from warehouse.upkeep.erasure import Traces
from warehouse.upkeep.erasure.proof import Proof, hits_in, paths_below, unreadable_hits


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
        record = facts_of(facts)
        # A damaged record says nothing: its version goes, too, and is fetched again when it is needed.
        if not record or any(traces.in_text(str(record.get(name, ""))) for name in ("scene", "scan", "content")):
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
        known = parse_json(store.read_bytes(), str(store))
    except FileNotFoundError:
        return 0
    except InputError:
        known = None
    if not isinstance(known, dict):  # damaged: the hashes are computed again
        store.unlink(missing_ok=True)
        return 1
    kept = {path: entry for path, entry in known.items() if not traces.in_text(path)}
    if len(kept) < len(known):
        write_whole(store, json.dumps(kept).encode(), cache=True)
    return len(known) - len(kept)


def temporary_entries() -> list[Path]:
    """The project's files and folders in the system's folder of temporary files that belong to this user, sorted."""
    return sorted(path for path in Path(tempfile.gettempdir()).glob("metascenes-*") if _is_own(path))


def _is_own(path: Path) -> bool:
    """True if a path is a file or folder of this user, and not a link."""
    try:
        return not path.is_symlink() and path.lstat().st_uid == os.geteuid()
    except FileNotFoundError:
        return False


def search_temporary(traces: Traces) -> Proof:
    """Look for the scene in the project's temporary files: those of a process that is at work may name it."""
    proof = Proof(0, 0, 0, ())
    for entry in temporary_entries():
        for path in (entry, *paths_below(entry)):
            proof |= _search(path, traces)
    return proof


def _search(path: Path, traces: Traces) -> Proof:
    """Look for the scene in the name of a path and in the content of a file; whoever owns it may remove it meanwhile."""
    try:
        data = path.read_bytes() if path.is_file() and not path.is_symlink() else b""
    except OSError as error:
        return Proof(0, 0, 0, tuple(unreadable_hits(path, error)))
    return Proof(1, len(data), 0, tuple(hits_in(str(path), data, traces)))
