"""Tables of text: rows of a view in, cells for the report or for a terminal out."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pyarrow as pa

ROW_LIMIT = 200
"""Rows that a table of the report shows; the SQL beside it gives all of them."""


@dataclasses.dataclass(frozen=True)
class Cell:
    """A cell as text; numbers are set to the right."""

    text: str
    is_number: bool


@dataclasses.dataclass(frozen=True)
class Grid:
    """A table as text. `omitted` counts rows that are not shown; `view` names the SQL behind it."""

    caption: str
    view: str
    headers: tuple[Cell, ...]
    rows: tuple[tuple[Cell, ...], ...]
    omitted: int


def portable(text: str) -> str:
    """Text without the folders of absolute paths: a report travels, and other machines have no such folders."""
    # folders after the first may have spaces in their names
    text = re.sub(r"(?:file://|(?<![\w.:/]))/[^\s/:;,'\"()<>]+/(?:[^/:;,'\"()<>\n]+/)*", "", text)
    return re.sub(r"\b[A-Za-z]:\\(?:[^\s\\:;,'\"]+\\)+", "", text)


def stage_table(timing: pa.Table, stages: Sequence[str]) -> str:
    """Times per stage as plain text: total, median and 95th percentile per scene, and per object. Rows of `stage_timing`."""
    rows = sorted(timing.to_pylist(), key=lambda row: place(row["stage"], stages))
    if not rows:
        return "no stage has run"
    lines = [("stage", "scenes", "total s", "median s", "p95 s", "s per object")]
    for row in rows:
        each = row["seconds_per_object"]
        lines.append(
            (
                row["stage"],
                str(row["scenes"]),
                f"{row['total_seconds']:.2f}",
                f"{row['median_seconds']:.2f}",
                f"{row['p95_seconds']:.2f}",
                "-" if each is None else f"{each:.3f}",
            )
        )
    lines.append(("all", "", f"{sum(row['total_seconds'] for row in rows):.2f}", "", "", ""))
    widths = [max(len(line[i]) for line in lines) for i in range(6)]
    aligned = (
        [text.ljust(width) if at == 0 else text.rjust(width) for at, (text, width) in enumerate(zip(line, widths, strict=True))]
        for line in lines
    )
    return "\n".join("  ".join(line).rstrip() for line in aligned)


Format = Callable[[Any], str]


def as_count(value: Any) -> str:
    """A whole number with thin spaces between thousands."""
    return f"{value:,}".replace(",", "\u202f")


def as_number(value: Any) -> str:
    """Three significant digits, without an exponent where people would not use one."""
    if value == 0:
        return "0"
    if abs(value) >= 1000:
        return as_count(round(value))
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{min(digits, 6)}f}"


def as_percent(value: Any) -> str:
    """A share as a whole percentage."""
    return f"{100 * value:.0f}%"


def as_share(value: Any) -> str:
    """A share as a percentage with one decimal: 100% means all, 0% means none."""
    rounded = round(100 * value, 1)
    return f"{min(max(rounded, 0.1), 99.9) if 0 < value < 1 else rounded:g}%"


def as_size(value: Any) -> str:
    """Bytes as kB or MB."""
    return f"{value / 1e6:.1f} MB" if value >= 1e5 else f"{value / 1e3:.1f} kB"


def as_text(value: Any) -> str:
    """Any value as text that names no folder of this machine."""
    return portable(str(value))


def as_yes(value: Any) -> str:
    """A verdict."""
    return "yes" if value else "no"


def as_box(value: Any) -> str:
    """Edges of a box [m]."""
    return " \u00d7 ".join(f"{edge:.2f}" for edge in value)


def grid(caption: str, view: str, rows: pa.Table, columns: Sequence[tuple[str, str, Format]]) -> Grid:
    """Columns of an Arrow table as text: (column, header, format) each. A missing value is a dash."""
    numeric = [form in (as_count, as_number, as_percent, as_share, as_size, as_box) for _, _, form in columns]
    shown = rows.slice(0, ROW_LIMIT).select([name for name, _, _ in columns]).to_pylist()
    cells = tuple(
        tuple(
            Cell("\u2013" if row[name] is None else form(row[name]), is_number)
            for (name, _, form), is_number in zip(columns, numeric, strict=True)
        )
        for row in shown
    )
    headers = tuple(Cell(header, is_number) for (_, header, _), is_number in zip(columns, numeric, strict=True))
    return Grid(caption, view, headers, cells, rows.num_rows - len(shown))


def report_grids(answers: Mapping[str, pa.Table], stages: Sequence[str]) -> dict[str, Grid]:
    """The report's tables over all scenes, by view. `answers`: rows of every view; `stages`: in the order of the data path."""
    timing = sorted(answers["stage_timing"].to_pylist(), key=lambda row: place(row["stage"], stages))
    ordered = {"stage_timing": pa.Table.from_pylist(timing, schema=answers["stage_timing"].schema)}
    return {view: grid(caption, view, ordered.get(view, answers[view]), shown) for view, (caption, shown) in _REPORT_COLUMNS.items()}


def place(stage: str, stages: Sequence[str]) -> tuple[int, str]:
    """Place of a stage in the order of the data path; unknown ones come last."""
    return (list(stages).index(stage) if stage in stages else len(stages), stage)


_REPORT_COLUMNS: Mapping[str, tuple[str, tuple[tuple[str, str, Format], ...]]] = {
    "stage_timing": (
        "Time per stage",
        (
            ("stage", "Stage", as_text),
            ("scenes", "Scenes", as_count),
            ("total_seconds", "Total [s]", as_number),
            ("median_seconds", "Median [s]", as_number),
            ("p95_seconds", "95th percentile [s]", as_number),
            ("seconds_per_object", "Per object [s]", as_number),
            ("peak_memory_mb", "Peak memory [MB]", as_number),
        ),
    ),
    "failures": (
        "Failed stages",
        (
            ("scene_id", "Scene", as_text),
            ("stage", "Stage", as_text),
            ("error_kind", "Kind", as_text),
            ("error", "What and what to do", as_text),
        ),
    ),
    "broken_rules": (
        "Broken export rules",
        (
            ("format", "Format", as_text),
            ("rule", "Rule", as_text),
            ("scene_id", "Scene", as_text),
            ("message", "What is wrong", as_text),
        ),
    ),
    "degradation_counts": (
        "Degradations",
        (
            ("stage", "Stage", as_text),
            ("degradation", "What was left out or replaced", as_text),
            ("times", "Times", as_count),
            ("scenes", "Scenes", as_count),
        ),
    ),
    "fallback_counts": (
        "Providers and fallbacks",
        (
            ("stage", "Stage", as_text),
            ("provider", "Provider", as_text),
            ("provider_version", "Version", as_text),
            ("answers", "Answers", as_count),
            ("fallbacks", "As a fallback", as_count),
        ),
    ),
    "selection_quality": (
        "Fit of the selected candidates",
        (
            ("category", "Category", as_text),
            ("objects", "Objects", as_count),
            ("median_score", "Median score", as_number),
            ("lowest_score", "Lowest", as_number),
            ("median_chamfer_m", "Chamfer distance [m]", as_number),
            ("median_coverage", "Coverage", as_percent),
            ("median_box_iou", "Box IoU", as_number),
        ),
    ),
    "scene_certificates": (
        "Plausible scenes",
        (
            ("scene_id", "Scene", as_text),
            ("method", "Method", as_text),
            ("engine", "Engine", as_text),
            ("deep_pairs", "Deep pairs", as_count),
            ("free", "Free", as_count),
            ("unstable_1cm", "Beyond 1 cm", as_count),
            ("unstable_5cm", "Beyond 5 cm or 5\u00b0", as_count),
            ("uncertified", "Uncertified", as_count),
            ("lost_supports", "Lost supports", as_count),
            ("implausible_densities", "Odd densities", as_count),
            ("remains", "Remains", as_count),
            ("is_plausible", "Plausible", as_yes),
        ),
    ),
    "unstable_objects": (
        "Objects that do not stay",
        (
            ("scene_id", "Scene", as_text),
            ("instance_id", "Instance", as_text),
            ("category", "Category", as_text),
            ("engine", "Engine", as_text),
            ("support", "Carried by", as_text),
            ("displacement_m", "Moves [m]", as_number),
            ("tilt_degrees", "Tilts [\u00b0]", as_number),
            ("start_penetration_m", "Starts at depth [m]", as_number),
            ("fails_5cm", "Fails at 5 cm or 5\u00b0", as_yes),
        ),
    ),
    "optimization_remains": (
        "What the optimization could not put right",
        (
            ("scene_id", "Scene", as_text),
            ("instance_id", "Instance", as_text),
            ("category", "Category", as_text),
            ("remains", "What remains", as_text),
        ),
    ),
    "support_counts": (
        "What carries the objects",
        (
            ("scene_id", "Scene", as_text),
            ("on_floor", "Floor", as_count),
            ("on_objects", "On others", as_count),
            ("inside_objects", "Inside others", as_count),
            ("on_walls", "Walls", as_count),
            ("on_ceiling", "Ceiling", as_count),
            ("unsupported", "Nothing", as_count),
            ("fixed", "Fixed", as_count),
            ("lost", "Lost", as_count),
        ),
    ),
    "density_check": (
        "Densities",
        (
            ("category", "Category", as_text),
            ("objects", "Objects", as_count),
            ("implausible", "Implausible", as_count),
            ("least_density_kg_m3", "Least [kg/m\u00b3]", as_number),
            ("median_density_kg_m3", "Median [kg/m\u00b3]", as_number),
            ("greatest_density_kg_m3", "Greatest [kg/m\u00b3]", as_number),
            ("allowed_from_kg_m3", "Allowed from", as_number),
            ("allowed_to_kg_m3", "Allowed to", as_number),
        ),
    ),
    "navigability": (
        "Navigable floor",
        (
            ("scene_id", "Scene", as_text),
            ("agent", "Agent", as_text),
            ("area_m2", "Free for its center [m\u00b2]", as_number),
            ("navigable_share", "Of the floor", as_percent),
            ("island_count", "Islands", as_count),
            ("largest_island_share", "Largest island", as_percent),
            ("episodes", "Episodes", as_count),
            ("targets", "Targets", as_count),
            ("unreachable_targets", "No episode possible", as_count),
        ),
    ),
    "navigation_metrics": (
        "How well policies navigate",
        (
            ("policy", "Policy", as_text),
            ("run_name", "Run", as_text),
            ("split", "Split", as_text),
            ("success_distance_m", "Success below [m]", as_number),
            ("n", "Trajectories", as_count),
            ("sr", "SR", as_share),
            ("sr_low", "from", as_share),
            ("sr_high", "to", as_share),
            ("spl", "SPL", as_number),
            ("sel", "SEL", as_number),
            ("el", "EL", as_number),
            ("curvature_turning_angle", "Curvature [rad/m]", as_number),
        ),
    ),
    "unreachable_objects": (
        "Objects that no episode could be made for",
        (
            ("scene_id", "Scene", as_text),
            ("instance_id", "Instance", as_text),
            ("category", "Category", as_text),
            ("reason", "Why", as_text),
        ),
    ),
    "export_verdicts": (
        "Exports",
        (
            ("scene_id", "Scene", as_text),
            ("format", "Format", as_text),
            ("files", "Files", as_count),
            ("size_bytes", "Size", as_size),
            ("rules", "Rules", as_count),
            ("broken_rules", "Broken", as_count),
            ("passed", "Passes", as_yes),
        ),
    ),
    "license_counts": (
        "Licenses",
        (
            ("material", "Of", as_text),
            ("license", "License", as_text),
            ("items", "Items", as_count),
            ("uses", "Uses", as_count),
            ("scenes", "Scenes", as_count),
        ),
    ),
    "attributions": (
        "Where placed assets come from",
        (
            ("license", "License", as_text),
            ("author", "Author", as_text),
            ("provider", "Provider", as_text),
            ("source", "Source", as_text),
            ("uses", "Uses", as_count),
        ),
    ),
}
