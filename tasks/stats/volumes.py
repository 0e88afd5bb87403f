"""Volumes by category as box plots on a logarithmic axis (supplementary, Fig. A7)."""

from __future__ import annotations

import pyarrow as pa

from tasks.stats.axes import volume_axis
from tasks.stats.style import INK, MUTED, SERIES, Picture, canvas, chart, in_style
from tasks.stats.tips import area

CATEGORY_LIMIT = 50
"""Categories in a box plot (supplementary, Fig. A7)."""

SMALLEST_VOLUME_M3 = 1e-6
"""A cubic centimetre. Flatter objects are drawn there: a logarithmic axis has no zero."""

OUTLIER_STEPS = 12
"""Places of outliers per factor e: those closer than 8 % would be drawn on top of each other, and are drawn once."""

_BLUE, _ORANGE, _TEAL = (SERIES[i].light for i in (0, 1, 5))


@in_style
def volume_boxes(boxes: pa.Table, outliers: pa.Table, of: str = "oriented box", name: str = "volume_by_category") -> Picture | None:
    """Volumes of objects, one box per category, on a logarithmic axis.

    Args:
        boxes: category, objects, frequency_rank, q1_m3, median_m3, q3_m3, whisker_low_m3, whisker_high_m3.
        outliers: category and volume_m3 of what lies beyond the whiskers.
        of: What the volume is of.
        name: Name of the picture and of its view.
    """
    shown = sorted((row for row in boxes.to_pylist() if row["frequency_rank"] <= CATEGORY_LIMIT), key=lambda row: row["frequency_rank"])
    if not shown:
        return None
    strays: dict[str, list[float]] = {row["category"]: [] for row in shown}
    for row in outliers.select(["category", "volume_m3"]).to_pylist():
        if row["category"] in strays:
            strays[row["category"]].append(max(row["volume_m3"], SMALLEST_VOLUME_M3))
    keys = {"whislo": "whisker_low_m3", "q1": "q1_m3", "med": "median_m3", "q3": "q3_m3", "whishi": "whisker_high_m3"}
    stats = [
        {
            "label": f"{row['category']} ({row['objects']})",
            "fliers": sorted(strays[row["category"]]),
            **{key: max(row[column], SMALLEST_VOLUME_M3) for key, column in keys.items()},
        }
        for row in shown
    ]
    axes = canvas(1.0 + 0.185 * len(stats))
    color = _BLUE if name == "volume_by_category" else _TEAL
    axes.bxp(
        stats,
        orientation="horizontal",
        patch_artist=True,
        widths=0.62,
        boxprops={"facecolor": color, "edgecolor": color, "alpha": 0.55},
        medianprops={"color": INK.light, "linewidth": 1.4},
        whiskerprops={"color": MUTED.light, "linewidth": 0.9},
        capprops={"color": MUTED.light, "linewidth": 0.9},
        flierprops={"marker": "o", "markersize": 2.2, "markerfacecolor": _ORANGE, "markeredgecolor": _ORANGE},
    )
    volume_axis(axes, [value for entry in stats for value in (entry["whislo"], entry["whishi"], *entry["fliers"])])
    for at, (row, entry) in enumerate(zip(shown, stats, strict=True), start=1):
        text = (
            f"{row['category']}: median {entry['med']:.3g} m³, half of them {entry['q1']:.3g} to {entry['q3']:.3g} m³, "
            f"{row['objects']} objects, {len(entry['fliers'])} outliers"
        )
        area(axes, (0.0, 1.0), (at - 0.5, at + 0.5), text, axes.get_yaxis_transform())
    axes.invert_yaxis()
    axes.tick_params(axis="y", labelsize=8, length=0)
    axes.set_xlabel(f"volume of the {of} [m³], logarithmic")
    what = "Volume" if name == "volume_by_category" else "Solid volume"
    title = f"{what} by category, top {CATEGORY_LIMIT}" if len(stats) >= CATEGORY_LIMIT else f"{what} by category"
    medians = {row["category"]: row["median_m3"] for row in shown}
    small, large = min(medians, key=lambda c: (medians[c], c)), max(medians, key=lambda c: (medians[c], c))
    alt = (
        f"Box plot of the volume of the {of} for {len(stats)} categories, most frequent first. Smallest median: {small}, "
        f"{medians[small]:.2g} m³; largest: {large}, {medians[large]:.2g} m³. Whiskers end at 1.5 times the interquartile range."
    )
    return chart(axes, name, title, alt)
