"""Read every file of a corpus by each reader that accepts it, and by the judges."""

from __future__ import annotations

import contextlib
import dataclasses
import shutil
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from bench.files.comparison import judges_differ, verdict_of
from bench.files.judges import ASSIMP, USD_ENDINGS, Verdict, by_assimp, by_usd, has_assimp
from bench.files.readers import DOCTORS, READERS
from bench.files.threejs import BROWSERS, ENDINGS, PACKAGES, threejs
from bench.goals import goal
from bench.machine import machine
from schemas.errors import InputError

VERDICTS = ("agrees", "refused", "noted", "unjudged", "silent")


@dataclasses.dataclass(frozen=True)
class FilesBench:
    """A corpus of files. corpus: its folder. part: only files whose paths hold this text."""

    corpus: Path
    part: str = ""

    @property
    def files(self) -> list[Path]:
        """Files that a reader accepts, sorted.

        Raises:
            InputError: the folder is missing, or holds none.
        """
        if not self.corpus.is_dir():
            raise InputError("metascenes bench files", str(self.corpus), "is not there", "name the corpus: --corpus FOLDER")
        endings = {ending for reader in READERS for ending in reader.endings}
        paths = [path for path in sorted(self.corpus.rglob("*")) if path.suffix.lower() in endings and path.is_file()]
        chosen = [path for path in paths if self.part in path.relative_to(self.corpus).as_posix()]
        if not chosen:
            raise InputError("metascenes bench files", str(self.corpus), "holds no model files", "name another folder: --corpus FOLDER")
        return chosen


def missing_judges() -> dict[str, str]:
    """Judges that this machine lacks, and how to get them."""
    missing = {} if has_assimp() else {ASSIMP: "apt-get install assimp-utils"}
    has_browser = any(map(shutil.which, BROWSERS))
    return missing | ({} if has_browser and PACKAGES.is_dir() else {"three.js": "`make client`, and apt-get install chromium"})


def run_files_bench(config: FilesBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """A row for each file and reader, and the goal.

    Raises:
        InputError: the corpus is missing, or neither judge of meshes is there.
    """
    files, missing = config.files, missing_judges()
    if len(missing) == 2:
        raise InputError("metascenes bench files", "judges", "are missing", "; ".join(missing.values()))
    rows: list[dict[str, Any]] = []
    differing: dict[str, tuple[str, ...]] = {}
    with contextlib.ExitStack() as stack:
        by_threejs = None if "three.js" in missing else stack.enter_context(threejs(config.corpus))
        for path in files:
            name = path.relative_to(config.corpus).as_posix()
            verdicts = _verdicts(path, by_threejs, missing)
            if different := judges_differ(verdicts):
                differing[name] = different
            rows += _rows(path, name, config.corpus, verdicts)
            advance(name)
    counts = Counter(row["verdict"] for row in rows)
    return {
        "machine": machine(), "config": {"corpus": str(config.corpus), "part": config.part, "seed": 0}, "missing": missing,
        "files": len(files), "counts": {verdict: counts[verdict] for verdict in VERDICTS}, "judges_differ": differing, "rows": rows,
        "goals": [goal("silent differences", counts["silent"], "<=", 0)],
    }  # fmt: skip


def _verdicts(path: Path, by_threejs: Callable[[Path], Verdict] | None, missing: Mapping[str, str]) -> dict[str, Verdict]:
    ending = path.suffix.lower()
    if ending in USD_ENDINGS:
        return {"usd": by_usd(path)}
    verdicts: dict[str, Verdict] = {} if ASSIMP in missing else {ASSIMP: by_assimp(path)}
    return verdicts | ({"three.js": by_threejs(path)} if by_threejs is not None and ending in ENDINGS else {})


def _rows(path: Path, name: str, corpus: Path, verdicts: Mapping[str, Verdict]) -> list[dict[str, Any]]:
    """One row for each reader. A doctor must name an error in each file that all readers of its kind refuse for its geometry."""
    rows: list[dict[str, Any]] = []
    accepting = [reader for reader in READERS if path.suffix.lower() in reader.endings]
    for reader in accepting:
        compared = verdict_of(reader.read(path, corpus), verdicts)
        row = {"file": name, "reader": reader.name, "verdict": compared.verdict, "reason": compared.reason}
        rows.append(row | {"unchecked": list(compared.unchecked)})
    for doctor in DOCTORS:
        if path.suffix.lower() in doctor.endings:
            outcome = doctor.read(path, corpus)
            is_refused = any(row["verdict"] == "refused" for row in rows if row["reader"] == "library")
            verdict = "refused" if outcome.reason else "silent" if is_refused else "noted" if outcome.notes else "agrees"
            reason = outcome.reason or "; ".join(outcome.notes)[:200]
            rows.append({"file": name, "reader": doctor.name, "verdict": verdict, "reason": reason, "unchecked": []})
    return rows
