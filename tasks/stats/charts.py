"""What comes of the stages, per provider or scene: the rows of a view in, a picture out. Nothing to draw gives None."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from tasks.stats.axes import bars, category_axis, whole_numbers
from tasks.stats.counts import SCENE_LIMIT
from tasks.stats.style import MUTED, SERIES, Picture, canvas, chart, in_style
from tasks.stats.tips import lines

_ORANGE, _GREEN, _GRAY = (SERIES[i].light for i in (1, 2, 8))


@in_style
def candidate_bars(wins: pa.Table) -> Picture | None:
    """Candidates that each provider filled, and how many of them won. Rows of `candidate_wins`."""
    rows = wins.to_pylist()
    if not rows:
        return None
    labels = [f"{row['slot']}  {row['provider']}" for row in rows]
    filled, won = (np.array([row[key] for row in rows], dtype=np.float64) for key in ("filled", "wins"))
    axes = canvas(1.5 + 0.27 * len(rows))
    y = np.arange(len(rows))
    axes.barh(y, filled, height=0.7, color=_GRAY, alpha=0.45, label="filled")
    axes.barh(y, won, height=0.42, color=_GREEN, label="ranked first")
    for at, (count, of) in enumerate(zip(won, filled, strict=True)):
        axes.annotate(f"{count:.0f} of {of:.0f}", (of, at), xytext=(5, 0), textcoords="offset points", va="center", fontsize=8)
    category_axis(axes, labels)
    lines(axes, [f"slot {r['slot']}, {r['provider']}: {r['wins']} ranked first of {r['filled']} filled" for r in rows])
    axes.margins(x=0.16)
    axes.set_xlabel("candidates, by slot and provider")
    title = "Which candidates win"
    axes.figure.legend(loc="outside lower center", ncols=2, handlelength=1.0)
    best = max(rows, key=lambda row: (row["wins"], row["provider"]))
    alt = f"Candidates filled and ranked first, per slot and provider. Most wins: {best['provider']}, {best['wins']} of {best['filled']}."
    return chart(axes, "candidate_wins", title, alt)


@in_style
def deep_pair_counts(losses: pa.Table) -> Picture | None:
    """Pairs deeper than 2 mm before and after the optimization, the worst scenes first. Rows of `collision_loss`.

    Unlike the loss, whose unit is the method's, they compare over all scenes.
    """
    order = sorted(losses.to_pylist(), key=lambda row: (-row["deep_pairs_before"], row["scene_id"]))[:SCENE_LIMIT]
    if not order:
        return None
    before, after = (np.array([row[f"deep_pairs_{when}"] for row in order]) for when in ("before", "after"))
    axes = canvas(1.6 + 0.26 * len(order))
    y = np.arange(len(order))
    axes.hlines(y, after, before, color=MUTED.light, linewidth=1.4, zorder=2)
    axes.plot(before, y, linestyle="none", marker="o", markersize=7, color=_ORANGE, label="proposed", zorder=3)
    axes.plot(after, y, linestyle="none", marker="o", markersize=5, color=_GREEN, label="optimized", zorder=3)
    category_axis(axes, [row["scene_id"] for row in order])
    lines(axes, [f"{r['scene_id']}: {r['deep_pairs_before']} pairs as proposed, {r['deep_pairs_after']} optimized" for r in order])
    axes.margins(x=0.06)
    whole_numbers(axes)
    axes.set_xlabel("pairs that penetrate deeper than 2 mm")
    title = "Collisions before and after"
    axes.figure.legend(loc="outside lower center", ncols=2, handlelength=1.0)
    alt = f"Pairs deeper than 2 mm in {len(order)} scenes: {before.sum()} as proposed, {after.sum()} after the optimization."
    return chart(axes, "collision_loss", title, alt)


@in_style
def stability_bars(rows: pa.Table) -> Picture | None:
    """Share of each scene's free objects that stay within 5 cm and within 1 cm, the least stable first. Rows of `stability`."""
    judged = [row for row in rows.to_pylist() if row["free"]]
    shipped = [row for row in judged if row["engine"] == "mujoco"]
    judged = shipped or judged  # other engines judge the same objects
    order = sorted(judged, key=lambda row: (row["stable_5cm_share"], row["stable_1cm_share"], row["scene_id"], row["engine"]))[:SCENE_LIMIT]
    if not order:
        return None
    five, within_1cm = (100 * np.array([row[f"stable_{limit}_share"] for row in order]) for limit in ("5cm", "1cm"))
    several = len({row["engine"] for row in order}) > 1
    axes = canvas(1.5 + 0.27 * len(order))
    y = np.arange(len(order))
    axes.barh(y, five, height=0.7, color=_GRAY, alpha=0.45, label="5 cm and 5 degrees")
    axes.barh(y, within_1cm, height=0.42, color=_GREEN, label="1 cm and 5 degrees")
    for at, row in enumerate(order):
        text = f"{row['stable_1cm']}, {row['stable_5cm']} of {row['free']}"
        axes.annotate(text, (max(five[at], within_1cm[at]), at), xytext=(5, 0), textcoords="offset points", va="center", fontsize=8)
    category_axis(axes, [f"{row['scene_id']} {row['engine']}" if several else row["scene_id"] for row in order])
    lines(
        axes,
        [
            f"{r['scene_id']}, {r['engine']}: {r['stable_1cm']} within 1 cm, {r['stable_5cm']} within 5 cm, of {r['free']} free objects; "
            f"{r['fixed']} fixed"
            for r in order
        ],
    )
    axes.set_xlim(0, 128)  # room for the numbers
    axes.set_xticks(range(0, 101, 20))
    axes.set_xlabel("free objects that stay within a limit [%]")
    title = "Stability under gravity"
    axes.figure.legend(loc="outside lower center", ncols=2, handlelength=1.0)
    total, fixed = (sum(row[key] for row in order) for key in ("free", "fixed"))
    alt = (
        f"Of {total} free objects in the scenes shown, {sum(row['stable_5cm'] for row in order)} stay within 5 cm and 5 degrees, "
        f"{sum(row['stable_1cm'] for row in order)} within 1 cm. {fixed} more are fixed."
    )
    return chart(axes, "stability", title, alt)


@in_style
def navigable_bars(floors: pa.Table) -> Picture | None:
    """Share of each scene's floor that an agent can reach, the least navigable first. Rows of `navigability`."""
    rows = [row for row in floors.to_pylist() if row["navigable_share"] is not None]
    order = sorted(rows, key=lambda row: (row["navigable_share"], row["scene_id"], row["agent"]))[:SCENE_LIMIT]
    if not order:
        return None
    share = np.array([row["navigable_share"] for row in order]) * 100
    agents = {row["agent"] for row in order}
    labels = [row["scene_id"] if len(agents) == 1 else f"{row['scene_id']} {row['agent']}" for row in order]
    axes = canvas(1.0 + 0.26 * len(order))
    bars(axes, labels, share, SERIES[5].light, "{:.0f}%", "of the floor")
    axes.set_xlabel("navigable share of the floor [%]")
    title = "Navigable floor"
    alt = f"Navigable share of the floor in {len(order)} scenes: {share.min():.0f}% to {share.max():.0f}%."
    return chart(axes, "navigability", title, alt)
