"""The head of a data card, by which the Hugging Face Hub and its library `datasets` find tables, license and size of a release."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from schemas.lineage.licenses import is_unknown
from schemas.tables import TABLES

if TYPE_CHECKING:
    from schemas.runs import Release
    from warehouse.release.attribution import Attribution
    from warehouse.release.card import ReleaseFile

SPLIT = "full"
"""The one split that a table is there: which rooms are to train and to test with is a table of its own, `splits`."""

FIRST = "scenes"
"""The table that is loaded when none is named."""

TASKS = ("robotics", "reinforcement-learning", "image-to-3d", "object-detection")
"""What releases are made for, in the Hub's words."""

TAGS = ("3d", "scenes", "replica", "simulation", "embodied-ai", "navigation", "usd", "mjcf", "habitat")

LICENSES = frozenset((
    "afl-3.0", "apache-2.0", "bsd-2-clause", "bsd-3-clause", "bsl-1.0", "cc0-1.0", "cc-by-2.0", "cc-by-2.5", "cc-by-3.0",
    "cc-by-4.0", "cc-by-sa-3.0", "cc-by-sa-4.0", "cc-by-nc-2.0", "cc-by-nc-3.0", "cc-by-nc-4.0", "cc-by-nd-4.0",
    "cc-by-nc-nd-3.0", "cc-by-nc-nd-4.0", "cc-by-nc-sa-2.0", "cc-by-nc-sa-3.0", "cc-by-nc-sa-4.0", "cdla-permissive-1.0",
    "cdla-permissive-2.0", "cdla-sharing-1.0", "gpl-2.0", "gpl-3.0", "isc", "lgpl-3.0", "mit", "mpl-2.0", "odbl", "odc-by",
    "pddl", "unlicense", "wtfpl", "zlib",
))  # fmt: skip
"""Licenses that the Hub has a word for: the SPDX identifier in small letters. Of those that others call by a version it has none."""

_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"), (10_000_000, "1M<n<10M"),
          (100_000_000, "10M<n<100M"), (1_000_000_000, "100M<n<1B"), (10_000_000_000, "1B<n<10B"))  # fmt: skip


def card_head(release: Release, attribution: Attribution, files: Sequence[ReleaseFile]) -> str:
    """YAML between two lines of dashes. Tables without rows are left out: `datasets` cannot load what has none."""
    import yaml

    held = [(file.path.removesuffix(".parquet"), file) for file in files if file.rows]
    # the first one is shown first
    configs: list[dict[str, Any]] = [
        {"config_name": name, "data_files": [{"split": SPLIT, "path": file.path}], **({"default": True} if name == FIRST else {})}
        for name, file in sorted(held, key=lambda pair: (pair[0] != FIRST, pair[0]))
    ]
    rows = sum(file.rows or 0 for name, file in held if (table := TABLES.get(name)) is not None and table.stage)
    fields: dict[str, Any] = {
        "pretty_name": f"MetaScenes lake, release {release.name}",
        "language": ["en"],
        **_license(attribution),
        "task_categories": list(TASKS),
        "size_categories": [next((name for limit, name in _SIZES if rows < limit), "n>1T")],
        "tags": list(TAGS),
    }
    if configs:
        fields["configs"] = configs
    return f"---\n{yaml.safe_dump(fields, sort_keys=False, allow_unicode=True, width=1000)}---\n"


def without_head(card: str) -> str:
    """A data card for people who read it as text."""
    _, dashes, rest = card.removeprefix("---\n").partition("\n---\n")
    return rest if card.startswith("---\n") and dashes else card


def _license(attribution: Attribution) -> dict[str, Any]:
    """All licenses where the Hub has words for each of them, else that they are others and where they are."""
    named = sorted({credit.license for credit in (*attribution.scans, *attribution.assets)})
    words = sorted({name.lower() for name in named})
    if words and LICENSES.issuperset(words):
        return {"license": words if len(words) > 1 else words[0]}
    if not words or all(map(is_unknown, named)):
        return {"license": "unknown"}
    return {"license": "other", "license_name": "several-see-attribution", "license_link": "ATTRIBUTION.md"}
