"""When and how long stages ran: per stage, per scene, and over time on each worker."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from tasks.stats.axes import category_axis
from tasks.stats.counts import SCENE_LIMIT
from tasks.stats.style import MUTED, SERIES, Picture, canvas, chart, in_style
from tasks.stats.tips import area, lines, name_mark

LANE_LIMIT = 24
"""Workers with a lane of their own, the busiest; a phone has place for no more."""

BINNED_LANES = 12
"""Workers with a lane of their own, the busiest, when runs are put together: every lane is eight areas."""

_BLUE, _ORANGE = SERIES[0].light, SERIES[1].light


@in_style
def stage_bars(timing: pa.Table, stages: Sequence[str]) -> Picture | None:
    """Median and 95th percentile of the seconds that a run of each stage takes, of a scene or of a batch. Rows of `stage_timing`."""
    by_stage = {row["stage"]: row for row in timing.to_pylist()}
    order = [stage for stage in stages if stage in by_stage]
    if not order:
        return None
    median = np.array([by_stage[stage]["median_seconds"] for stage in order])
    p95 = np.array([by_stage[stage]["p95_seconds"] for stage in order])
    axes = canvas(1.1 + 0.3 * len(order))
    y = np.arange(len(order))
    axes.barh(y, median, height=0.6, color=_BLUE)
    axes.hlines(y, median, p95, color=_ORANGE, linewidth=1.6)
    axes.plot(p95, y, linestyle="none", marker="|", markersize=9, markeredgewidth=2, color=_ORANGE)
    for at, (low, high) in enumerate(zip(median, p95, strict=True)):
        axes.annotate(f"{low:.2f} s", (max(low, high), at), xytext=(6, 0), textcoords="offset points", va="center", fontsize=8)
    category_axis(axes, order)
    lines(axes, [f"{stage}: median {low:.2f} s, 95th percentile {high:.2f} s" for stage, low, high in zip(order, median, p95, strict=True)])
    axes.margins(x=0.14)
    axes.set_xlim(left=0)
    axes.set_xlabel("seconds per run: median (bar), 95th percentile (mark)")
    title = "Time per stage"
    slowest = order[int(np.argmax(median))]
    alt = f"Seconds per run of each stage. Slowest: {slowest}, median {median.max():.2f} s."
    return chart(axes, "stage_timing", title, alt)


@in_style
def scene_bars(runs: pa.Table, total: int, stages: Sequence[str]) -> Picture | None:
    """Seconds per scene, split by stage. Rows of `current_runs` of the slowest scenes: scene_id, stage, seconds.

    `total` counts all scenes with a run.
    """
    seconds: dict[str, dict[str, float]] = {}
    for row in runs.select(["scene_id", "stage", "seconds"]).to_pylist():
        seconds.setdefault(row["scene_id"], {})[row["stage"]] = row["seconds"]
    totals = {scene: sum(parts.values()) for scene, parts in seconds.items()}
    order = sorted(totals, key=lambda scene: (-totals[scene], scene))[:SCENE_LIMIT]
    if not order:
        return None
    axes = canvas(1.5 + 0.26 * len(order))
    left = np.zeros(len(order))
    for index, stage in enumerate(stages):
        width = np.array([seconds[scene].get(stage, 0.0) for scene in order])
        if width.any():
            color = SERIES[index % len(SERIES)].light
            drawn = axes.barh(np.arange(len(order)), width, left=left, height=0.66, color=color, label=stage)
            for scene, seconds_of, patch in zip(order, width, drawn, strict=True):
                if seconds_of:
                    name_mark(patch, f"{scene}, {stage}: {seconds_of:.1f} s of {totals[scene]:.1f} s")
            left += width
    category_axis(axes, order)
    axes.set_xlabel("seconds")
    title = "Time per scene" if len(order) == total else f"Time of the {len(order)} slowest scenes"
    axes.figure.legend(loc="outside lower center", ncols=4, handlelength=1.0, columnspacing=1.2)
    alt = f"{title}, split by stage. Slowest: {order[0]}, {totals[order[0]]:.1f} s."
    return chart(axes, "scene_timing", title, alt)


@in_style
def run_gantt(bars: pa.Table, pauses: pa.Table, workers: int, stages: Sequence[str]) -> Picture | None:
    """What each worker did over time, colored by stage; pauses of all workers are cut out and marked.

    Few runs are a bar each. Many are put together in bins of time, and a lane shows the share of its time that each stage took.
    Workers are numbered in the order in which they began, host by host: a report names no machine.

    Args:
        bars: host (`name:process`), stage, begins and ends [s] after the first run, pauses left out; share: of that time that the
            worker was at work on it, 1 for a single run; runs: how many began in it.
        pauses: at [s] and seconds of what was cut out.
        workers: How many there are, with a bar or without.
        stages: In the order of the data path.
    """
    rows = _busiest(bars.to_pylist())
    if not rows:
        return None
    lanes = _lanes(rows)
    binned = any(row["runs"] != 1 for row in rows)
    axes = canvas(1.7 + 0.3 * len(lanes))
    end = max(row["ends"] for row in rows)
    known = [*stages, *sorted({row["stage"] for row in rows} - set(stages))]
    draw = _stacks if binned else _blocks
    notes = draw(axes, rows, lanes, [stage for stage in known if any(row["stage"] == stage for row in rows)], known, end)
    category_axis(axes, [name for _, name in lanes.values()])
    axes.tick_params(axis="y", labelsize=8)
    axes.set_xlim(0, 1.01 * end)
    _mark_pauses(axes, pauses.to_pylist(), end, len(lanes))
    if workers > len(lanes):
        notes.append(f"the {len(lanes)} busiest of {workers} workers")
    _time_axis(axes, end, notes)
    title = "What ran when"
    axes.figure.legend(loc="outside lower center", ncols=4, handlelength=1.0, columnspacing=1.2)
    runs = sum(row["runs"] for row in rows)
    alt = (
        f"Timeline of {workers} worker{'s' if workers != 1 else ''} over {_duration(end)}, colored by stage, {runs} "
        + ("runs put together in bins of time" if binned else "runs")
        + (f"; {pauses.num_rows} pause{'s' if pauses.num_rows != 1 else ''} left out." if pauses.num_rows else ".")
    )
    return chart(axes, "run_timeline", title, alt)


Rows = Sequence[dict[str, Any]]
Lanes = dict[str, tuple[int, str]]


def _blocks(axes: Any, rows: Rows, lanes: Lanes, shown: Sequence[str], known: Sequence[str], end: float) -> list[str]:
    """A bar for each run."""
    for stage in shown:
        of = [row for row in rows if row["stage"] == stage]
        left = np.array([row["begins"] for row in of])
        width = np.maximum(np.array([row["ends"] for row in of]) - left, end / 900)  # shorter ones would not be seen
        at = np.array([lanes[row["host"]][0] for row in of])
        drawn = axes.barh(at, width, left=left, height=0.76, color=_color(stage, known), linewidth=0, label=stage)
        for row, patch in zip(of, drawn, strict=True):
            name_mark(patch, f"{stage}, {lanes[row['host']][1]}: {row['ends'] - row['begins']:.2f} s from {_duration(row['begins'])}")
    return []


def _stacks(axes: Any, rows: Rows, lanes: Lanes, shown: Sequence[str], known: Sequence[str], end: float) -> list[str]:
    """In each lane the shares of the stages over time, on top of each other; where little is done, drawn larger."""
    bins = sorted({row["begins"] for row in rows})
    place = {begins: at for at, begins in enumerate(bins)}
    share = np.zeros((len(lanes), len(shown), len(bins)))
    for row in rows:
        share[lanes[row["host"]][0], shown.index(row["stage"]), place[row["begins"]]] += row["share"]
    most = float(share.sum(axis=1).max())
    full = next(step for step in (0.02, 0.05, 0.1, 0.2, 0.5, 1.0) if most <= step or step == 1.0)
    tops = np.minimum(np.cumsum(share, axis=1) / full, 1.0)
    middle = np.array(bins) + 0.5 * (rows[0]["ends"] - rows[0]["begins"])
    for index, stage in enumerate(shown):
        low = tops[:, index - 1] if index else np.zeros_like(tops[:, 0])
        for lane in range(len(lanes)):
            foot = lane + 0.40
            axes.fill_between(
                middle, foot - 0.8 * low[lane], foot - 0.8 * tops[lane, index], color=_color(stage, known), linewidth=0,
                label=stage if lane == 0 else None,
            )  # fmt: skip
    for worker, (lane, name) in lanes.items():
        busy = sorted((sum(row["share"] for row in rows if row["host"] == worker and row["stage"] == stage), stage) for stage in shown)
        length = rows[0]["ends"] - rows[0]["begins"]
        text = ", ".join(f"{stage} {_duration(share_of * length)}" for share_of, stage in reversed(busy) if share_of)
        area(axes, (0.0, 1.0), (lane - 0.5, lane + 0.5), f"{name}: {text}", axes.get_yaxis_transform())
    return [f"height: share at work, a full lane is {full:.0%}", f"{len(bins)} bins of {_duration(end / len(bins))}"]


def _color(stage: str, known: Sequence[str]) -> str:
    return SERIES[min(known.index(stage), len(SERIES) - 1)].light


def _busiest(rows: Rows) -> Rows:
    """Rows of the workers that have a lane."""
    seconds: dict[str, float] = {}
    for row in rows:
        seconds[row["host"]] = seconds.get(row["host"], 0.0) + (row["ends"] - row["begins"]) * row["share"]
    kept = set(sorted(seconds, key=lambda worker: (-seconds[worker], worker))[:LANE_LIMIT])
    return [row for row in rows if row["host"] in kept]


def _lanes(rows: Rows) -> Lanes:
    """Lane and name of each worker: hosts in the order of their first run, and workers of a host, too."""
    began: dict[str, float] = {}
    for row in rows:
        began[row["host"]] = min(began.get(row["host"], np.inf), row["begins"])
    machine = {worker: worker.rpartition(":")[0] or worker for worker in began}
    first: dict[str, float] = {}
    for worker, at in began.items():
        first[machine[worker]] = min(first.get(machine[worker], np.inf), at)
    hosts = sorted(first, key=lambda host: (first[host], host))
    lanes: Lanes = {}
    for number, host in enumerate(hosts, start=1):
        own = sorted((worker for worker in began if machine[worker] == host), key=lambda worker: (began[worker], worker))
        for place, worker in enumerate(own, start=1):
            lanes[worker] = (len(lanes), f"worker {place}" if len(hosts) == 1 else f"host {number}, worker {place}")
    return lanes


def _mark_pauses(axes: Any, pauses: Sequence[dict[str, Any]], end: float, lanes: int) -> None:
    """A dashed line where all workers paused; the longest ones, as far as there is place, say how long."""
    marked: list[float] = []
    for pause in sorted(pauses, key=lambda row: (-row["seconds"], row["at"])):
        axes.axvline(pause["at"], color=MUTED.light, linewidth=0.9, linestyle=(0, (3, 2)))
        if all(abs(pause["at"] - other) > 0.16 * end for other in marked) and len(marked) < 4:
            marked.append(pause["at"])
            axes.annotate(
                f"{_duration(pause['seconds'])} later", (pause["at"], lanes - 0.42), xytext=(2, 0), textcoords="offset points",
                fontsize=6.5, color=MUTED.light, va="bottom", ha="right" if pause["at"] > 0.8 * end else "left",
            )  # fmt: skip


def _time_axis(axes: Any, end: float, notes: Sequence[str]) -> None:
    """Ticks in the unit that suits the length [s], and below them the notes."""
    from matplotlib.ticker import FuncFormatter, MultipleLocator

    factor, unit = next((f, u) for limit, f, u in ((240, 1, "s"), (4 * 3600, 60, "min"), (np.inf, 3600, "h")) if end <= limit)
    axes.xaxis.set_major_locator(MultipleLocator(factor * _step(end / factor)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / factor:g}"))
    axes.set_xlabel("\n".join([f"time at work [{unit}]", *notes]))


def _step(length: float) -> float:
    """A round step of which four to eight make the length."""
    power = 10.0 ** np.floor(np.log10(max(length, 1e-9) / 4))
    return float(max(factor * power for factor in (1, 2, 5) if factor * power <= max(length, 1e-9) / 4))


def _duration(seconds: float) -> str:
    """A length of time as people say it."""
    for limit, unit in ((2 * 86400, "days"), (2 * 3600, "h"), (120, "min")):
        if seconds >= limit:
            return f"{seconds / {'days': 86400, 'h': 3600, 'min': 60}[unit]:.0f} {unit}"
    return f"{seconds:.0f} s"
