"""Whom and what to name when scenes are handed on: the scans, and the assets that were placed."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from schemas.lineage.licenses import BESIDE, UNKNOWN, is_partly_unknown, is_unknown, of_asset, scan_of, stated
from schemas.text import markdown_cell, page_text
from warehouse.release.licenses import duties

if TYPE_CHECKING:
    import duckdb

IMPORTED = "imported"
"""Provider of the assets of finished datasets."""


@dataclasses.dataclass(frozen=True, order=True)
class Credit:
    """A line of an attribution: `what` was made by `author` under `license`, and is used in `scenes`."""

    license: str
    author: str
    what: str
    items: int
    scenes: int


@dataclasses.dataclass(frozen=True)
class Attribution:
    """Credits of scans and of placed assets, each sorted by license."""

    scans: tuple[Credit, ...]
    assets: tuple[Credit, ...]

    def page(self, title: str) -> str:
        """`ATTRIBUTION.md`."""
        lines = [f"# {title}", ""]
        lines += ["What the lake knows of where scans and assets come from. Whoever hands scenes on does what the licenses ask.", ""]
        unknown = [credit for credit in (*self.scans, *self.assets) if is_partly_unknown(credit.license)]
        if unknown:
            items = sum(credit.items for credit in unknown)
            lines += [f"**{items} of these have no known license.** They must not be handed on before somebody has asked.", ""]
        for head, noun, credits in (("Scans", "scans", self.scans), ("Assets", "assets", self.assets)):
            lines += [f"## {head}", ""]
            if not credits:
                lines += ["None.", ""]
                continue
            lines += [f"| license | what it asks | author | source | {noun} | scenes |", "|---|---|---|---|---|---|"]
            for credit in credits:
                cells = (credit.license, duties(credit.license), credit.author, credit.what, credit.items, credit.scenes)
                lines.append("| " + " | ".join(markdown_cell(value) for value in cells) + " |")
            lines.append("")
        return page_text("\n".join(lines))


def attribution_of(connection: duckdb.DuckDBPyConnection) -> Attribution:
    """The attribution of all scenes that a connection reads."""
    scans = connection.execute("SELECT coalesce(license, ''), dataset, count(*) FROM scenes GROUP BY ALL").fetchall()
    assets = connection.execute(
        "WITH imported AS (SELECT asset_id, list(DISTINCT split_part(scene_id, '/', 1)) AS datasets FROM placements"
        f" JOIN assets USING (asset_id) WHERE assets.provider = '{IMPORTED}' GROUP BY asset_id)"
        " SELECT assets.license, coalesce(assets.author, ''), assets.source, list_sort(coalesce(imported.datasets, [])) AS datasets,"
        " scenes.license, count(DISTINCT assets.asset_id), count(DISTINCT placements.scene_id)"
        " FROM placements JOIN assets USING (asset_id) LEFT JOIN imported USING (asset_id)"
        " LEFT JOIN scenes ON split_part(assets.source, '; ', 1) = 'scan ' || scenes.scene_id GROUP BY ALL"
    ).fetchall()
    return _attribution(
        [(license_, dataset, count) for license_, dataset, count in scans],
        [(of_asset(license_, source, {scan_of(source): scan}), author, _source(source, datasets), items, scenes)
         for license_, author, source, datasets, scan, items, scenes in assets],
    )  # fmt: skip


def _source(source: str, datasets: Iterable[str]) -> str:
    """Where an asset came from. Of one that was imported, the file alone does not say from which dataset."""
    named = ", ".join(sorted(datasets))
    return f"dataset {named}: {source or UNKNOWN}" if named and not source.startswith("scan ") else source


def _attribution(scans: Sequence[tuple[str, str, int]], assets: Sequence[tuple[str, str, str, int, int]]) -> Attribution:
    made = [Credit(stated(license_), UNKNOWN, f"dataset {dataset}", count, count) for license_, dataset, count in scans]
    # Assets that were cut from scans are many sources; their credit is the dataset's.
    summed: dict[tuple[str, str, str], Counter[str]] = {}
    for license_, author, source, items, scenes in assets:
        what = source or UNKNOWN
        if source.startswith("scan "):
            dataset, _, model = scan_of(source).partition("/")[0], *source.partition(BESIDE)[1:]
            what = f"{model}, painted with scans of {dataset}" if model else f"cut from scans of {dataset}"
        counts = summed.setdefault((license_, UNKNOWN if is_unknown(author) else author, what), Counter())
        counts.update(items=items, scenes=scenes)
    used = [Credit(*key, counts["items"], counts["scenes"]) for key, counts in summed.items()]
    return Attribution(tuple(sorted(made)), tuple(sorted(used)))


def attribution_of_rows(
    scans: Mapping[str, tuple[str, str | None]], placed: Sequence[tuple[str, str, str, str | None, str, str]]
) -> Attribution:
    """The attribution of some scenes. scans: dataset and license by scene. placed: scene, asset, license, author, source, provider.

    The license of an asset that was cut from a scan is looked up among `scans`.
    """
    licenses = {scene: license_ for scene, (_, license_) in scans.items()}
    counts = Counter((license_ or "", dataset) for dataset, license_ in scans.values())
    items: dict[tuple[str, str, str], tuple[set[str], set[str]]] = {}
    datasets: dict[str, set[str]] = {}
    for scene, asset, _, _, _, provider in placed:
        if provider == IMPORTED:
            datasets.setdefault(asset, set()).add(scene.partition("/")[0])
    for scene, asset, license_, author, source, _ in placed:
        whence = _source(source, datasets.get(asset, ()))
        named = items.setdefault((of_asset(license_, source, licenses), author or "", whence), (set(), set()))
        named[0].add(asset)
        named[1].add(scene)
    return _attribution(
        [(license_, dataset, count) for (license_, dataset), count in counts.items()],
        [(*key, len(assets), len(scenes)) for key, (assets, scenes) in items.items()],
    )
