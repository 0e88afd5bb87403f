"""The data card of a release: what it holds, where that comes from, what it is worth, and how to cite it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from schemas.lineage.licenses import is_partly_unknown, is_unknown
from schemas.runs import Release
from schemas.tables import TABLES
from schemas.text import markdown_cell, page_text
from schemas.wording import noun
from warehouse.release.attribution import Attribution
from warehouse.release.catalog import variable_of
from warehouse.release.hub import card_head

if TYPE_CHECKING:
    import duckdb


@dataclasses.dataclass(frozen=True)
class ReleaseFile:
    """A file of a release: its name, size [B], SHA-256, and rows where it is a table."""

    path: str
    bytes: int
    sha256: str
    rows: int | None = None


_MOST_LINES = 20
"""Of what a table of the card shows; it says how many there are."""

_SOURCES = """
    SELECT dataset, scan_format AS format, segmentation AS "instances from", count(*) AS scenes,
        string_agg(DISTINCT stated_license(license), ', ' ORDER BY stated_license(license)) AS licenses
    FROM scenes GROUP BY ALL ORDER BY ALL
"""
_ANSWERS = """
    SELECT stage, provider, provider_version AS version, answers, fallbacks FROM fallback_counts ORDER BY stage, answers DESC, provider
"""
_PER_SCENE = """
    SELECT what AS "per scene", min(n) AS least, median(n) AS median, round(avg(n), 1) AS mean, max(n) AS most
    FROM (SELECT 'objects' AS what, objects AS n FROM objects_per_scene
        UNION ALL SELECT 'categories', categories FROM categories_per_scene)
    GROUP BY what ORDER BY what DESC
"""
_DATASETS = """
    SELECT dataset, scenes, median_objects_per_scene AS "objects per scene, median", objects, categories AS "categories in the label map",
        placed_objects AS "placed objects", round(100 * placed_share, 1) AS "placed [%]", median_box_volume_m3 AS "box, median [m3]"
    FROM dataset_comparison ORDER BY dataset
"""
_CATEGORIES = 'SELECT category, objects, scenes, round(100 * share, 1) AS "share [%]" FROM category_counts ORDER BY objects DESC, category'
_WINS = """
    SELECT provider, CAST(sum(filled) AS BIGINT) AS filled, CAST(sum(fallbacks) AS BIGINT) AS fallbacks, CAST(sum(wins) AS BIGINT) AS wins
    FROM candidate_wins GROUP BY provider ORDER BY wins DESC, provider
"""
_LAYOUT = """
    SELECT 'deep pairs before optimization' AS figure, CAST(coalesce(sum(deep_pairs_before), 0) AS VARCHAR) AS value FROM collision_loss
    UNION ALL SELECT 'deep pairs after optimization', CAST(coalesce(sum(deep_pairs_after), 0) AS VARCHAR) FROM collision_loss
    UNION ALL SELECT engine || ': free objects that stay within 1 cm', format('{} of {}', sum(stable_1cm), sum(free))
        FROM stability GROUP BY engine
    UNION ALL SELECT engine || ': free objects that stay within 5 cm', format('{} of {}', sum(stable_5cm), sum(free))
        FROM stability GROUP BY engine
    UNION ALL SELECT 'floor that agent ' || agent || ' can reach, mean share [%]', CAST(round(100 * avg(navigable_share), 1) AS VARCHAR)
        FROM navigability GROUP BY agent
    UNION ALL SELECT format || ': scenes whose export passes every check', 
        format('{} of {}', count(*) FILTER (passed), count(*)) FROM export_verdicts GROUP BY format
    ORDER BY figure
"""
_TIMES = """
    SELECT stage, scenes, runs, round(median_seconds, 2) AS "median [s]", round(p95_seconds, 2) AS "p95 [s]"
    FROM stage_timing ORDER BY stage
"""
_UNPLACED = """
    SELECT count(*) FROM (SELECT scene_id, instance_id FROM instances WHERE NOT is_structure
        EXCEPT SELECT scene_id, instance_id FROM placements)
"""
_UNSTABLE = """
    SELECT count(DISTINCT (scene_id, instance_id)) FILTER (problem IS NOT NULL),
        count(DISTINCT (scene_id, instance_id)) FILTER (NOT is_stable_5cm) FROM unstable_objects
"""


def data_card(release: Release, connection: duckdb.DuckDBPyConnection, attribution: Attribution, files: Sequence[ReleaseFile]) -> str:
    """`README.md` of a release. `connection` reads its tables and views; `files` are those that are written already."""
    ask = _Answers(connection)
    parts = [_head(release), _contents(release), _sources(ask), _licenses(attribution), _figures(ask), _limits(release, ask, attribution)]
    text = "\n".join([*parts, _files(release, files), _citation(release, files)])
    return page_text(card_head(release, attribution, files) + text)


class _Answers:
    """Answers of SQL as Markdown tables, and single numbers."""

    def __init__(self, connection: duckdb.DuckDBPyConnection) -> None:
        self._connection = connection

    def table(self, sql: str, nothing: str = "None.", most: int = _MOST_LINES) -> str:
        cursor = self._connection.execute(sql)
        names, rows = [column[0] for column in cursor.description or ()], cursor.fetchall()
        if not rows:
            return f"{nothing}\n"
        lines = [f"| {' | '.join(names)} |", "|" + "---|" * len(names)]
        lines += [f"| {' | '.join(markdown_cell(_shown(value)) for value in row)} |" for row in rows[:most]]
        if len(rows) > most:
            lines += ["", f"The first {most} of {len(rows):,}."]
        return "\n".join(lines) + "\n"

    def row(self, sql: str) -> tuple[Any, ...]:
        row: tuple[Any, ...] = self._connection.execute(sql).fetchall()[0]
        return row


def _shown(value: Any) -> Any:
    return "" if value is None else f"{value:g}" if isinstance(value, float) else value


def _head(release: Release) -> str:
    lines = [f"# Data card: release {release.name}", ""]
    if release.notes:
        lines += [release.notes, ""]
    lines += [f"Snapshot {release.snapshot_id} of the lake, released on {release.created_at:%Y-%m-%d %H:%M} UTC",
              f"by version {release.code_version} of the project. A release is never changed."]  # fmt: skip
    if release.erased_at:
        times = ", ".join(time[:10] for time in release.erased_at)
        lines += ["", f"Something was erased from it, as a private home may ask at any time: {times}. All figures are of what is left."]
    return "\n".join(lines) + "\n"


def _contents(release: Release) -> str:
    names = ("scenes", "rooms", "objects", "categories", "placed_objects", "assets", "episodes")
    counts = [(name.replace("_", " "), getattr(release, name)) for name in names]
    return (
        "\n".join(["## What it holds", "", "| what | count |", "|---|---|", *(f"| {what} | {count:,} |" for what, count in counts)]) + "\n"
    )


def _sources(ask: _Answers) -> str:
    return "\n".join(["## Where it comes from", "", ask.table(_SOURCES), "Who answered, and how often only as a fallback:", "",
                      ask.table(_ANSWERS)])  # fmt: skip


def _licenses(attribution: Attribution) -> str:
    lines = ["## Licenses", "", "| material | license | items |", "|---|---|---|"]
    for material, credits in (("scans", attribution.scans), ("assets", attribution.assets)):
        for name in sorted({credit.license for credit in credits}):
            own = [credit for credit in credits if credit.license == name]
            lines.append(f"| {material} | {markdown_cell(name)} | {sum(c.items for c in own):,} |")
    lines += ["", "`ATTRIBUTION.md` says whom to name and what each license asks. Assets that were cut from a scan have its license.",
              "`metascenes export --release NAME --license-allow ...` leaves out what may not be shipped."]  # fmt: skip
    return "\n".join(lines) + "\n"


def _figures(ask: _Answers) -> str:
    parts = ["## Figures", "", ask.table(_PER_SCENE)]
    if ask.row("SELECT count(DISTINCT dataset) FROM scenes")[0] > 1:
        parts += ["These and all figures below are of all datasets together. By dataset (`dataset_comparison`):", "", ask.table(_DATASETS)]
    parts += ["The most frequent categories:", "", ask.table(_CATEGORIES, most=10),
             "Candidates by provider:", "", ask.table(_WINS), "Layout, stability, navigation and exports:", "", ask.table(_LAYOUT),
             "Time of the stages per run (annotation, evaluation: of a batch; imports aside):", "", ask.table(_TIMES)]  # fmt: skip
    return "\n".join(parts)


def _limits(release: Release, ask: _Answers, attribution: Attribution) -> str:
    unplaced = ask.row(_UNPLACED)[0]
    refused, unstable = ask.row(_UNSTABLE)
    answers, fallbacks = ask.row("SELECT coalesce(sum(answers), 0), coalesce(sum(fallbacks), 0) FROM fallback_counts")
    unknown = [sum(c.items for c in credits if is_partly_unknown(c.license)) for credits in (attribution.scans, attribution.assets)]
    authors = sum(credit.items for credit in attribution.assets if is_unknown(credit.author))
    unreachable = ask.row("SELECT count(*) FROM unreachable_targets")[0]
    lines = [
        "## Known limits",
        "",
        (
            f"- {fallbacks:,} of {answers:,} {noun(answers, 'answer')} of captions and candidates "
            f"{noun(fallbacks, 'is a fallback', 'are fallbacks')}: their provider had nothing, another stood in."
        ),
        f"- {unplaced:,} of {release.objects:,} {noun(release.objects, 'object')} {noun(unplaced, 'has', 'have')} no asset in their place.",
        (
            f"- {unstable:,} {noun(unstable, 'placed object does', 'placed objects do')} not stay "
            f"within 5 cm and 5 degrees; {refused:,} could not be simulated (`unstable_objects`)."
        ),
        (
            f"- {unreachable:,} {noun(unreachable, 'object is', 'objects are')} such "
            f"that no episode could be made for them (`unreachable_objects` says why)."
        ),
        (
            f"- {unknown[0]:,} {noun(unknown[0], 'scan')} and {unknown[1]:,} placed {noun(unknown[1], 'asset')} "
            f"have no known license; {authors:,} placed {noun(authors, 'asset')} no known author."
        ),
        "",
        "What had to be left out or done otherwise (`degradation_counts`):",
        "",
        ask.table("SELECT stage, degradation, times, scenes FROM degradation_counts ORDER BY times DESC, stage, degradation"),
        "What failed at its last attempt (`failures`); what an earlier attempt gave may be in it:",
        "",
        ask.table("SELECT scene_id AS scene, stage, error_kind AS kind, error FROM failures ORDER BY scene_id, stage"),
        "Checks of exports that are not passed (`broken_rules`):",
        "",
        ask.table("SELECT format, rule, count(*) AS scenes FROM broken_rules GROUP BY ALL ORDER BY scenes DESC, format, rule"),
    ]
    return "\n".join(lines)


def _files(release: Release, files: Sequence[ReleaseFile]) -> str:
    lines = ["## Files", "", "Plain Parquet, one file per table, sorted by its key, zstd. `tables.md` says what every column means,",
             "`SHA256SUMS` what every file's checksum is (`sha256sum -c SHA256SUMS`), `release.json` the same for programs,",
             "`croissant.json` all of this as Croissant says it.", "",
             "| file | rows | bytes | SHA-256 |", "|---|---|---|---|"]  # fmt: skip
    lines += [
        f"| {markdown_cell(file.path)} | {file.rows:,} | {file.bytes:,} | `{file.sha256[:16]}...` |"
        for file in files
        if file.rows is not None
    ]
    lines += ["", f"`{release.name}.duckdb` has a view of each table, and every view and macro of the lake with its comment:", "",
              "```sql", f"ATTACH '{release.name}.duckdb' AS r (READ_ONLY);", "SELECT * FROM r.headline;", "```", "",
              "The views know where this folder was when it was made. Where it was moved or copied to, say so first:", "",
              "```sql", f'SET VARIABLE "{variable_of(release.name)}" = \'/where/it/is/now\';', "```"]  # fmt: skip
    return "\n".join(lines) + "\n"


def _citation(release: Release, files: Sequence[ReleaseFile]) -> str:
    lines = ["## How to cite", "", "Name the release, its snapshot and its checksum, so that others know whether they have the same:", "",
             *(f"> {line}" for line in cited(release, files)), "",
             "The checksum is that of the lines `<SHA-256>  <file>` of the stages' tables in the order of the file names."]  # fmt: skip
    return "\n".join(lines) + "\n"


def cited(release: Release, files: Sequence[ReleaseFile]) -> tuple[str, str]:
    """How to cite a release: two lines."""
    kept = [file for file in files if file.path.removesuffix(".parquet") in TABLES]
    what = f"MetaScenes lake, release {release.name}, snapshot {release.snapshot_id}, {release.created_at:%Y-%m-%d},"
    return what, f"SHA-256 {digest_of(kept)}"


def digest_of(files: Sequence[ReleaseFile]) -> str:
    """One SHA-256 of the tables that the stages wrote; what the lake says about itself, times included, does not count."""
    import hashlib

    counted = [file for file in files if (table := TABLES.get(file.path.removesuffix(".parquet"))) is not None and table.stage]
    return hashlib.sha256("".join(f"{f.sha256}  {f.path}\n" for f in sorted(counted, key=lambda f: f.path)).encode()).hexdigest()
