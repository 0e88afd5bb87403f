"""`metascenes bench`: what our claims about quality and speed rest on, measured again on any machine."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from flows.commands.options import json_option

if TYPE_CHECKING:
    from rich.console import Console

METHODS = ("paper", "default")

_OPTIONS = {"rooms": "--rooms", "address": "--lake", "moves_only": "--moves-only"}


@click.group("bench", short_help="Measure quality and speed on this machine.")
def command() -> None:
    """Measure quality and speed on this machine.

    Example: metascenes bench optimization --rooms 5
    """


@command.command("optimization")
@click.option("--rooms", type=click.IntRange(1, 10_000), default=50, show_default=True, help="Generated rooms, with things out of place.")
@click.option("--lake", "address", metavar="ADDRESS", help="Measure the scenes of this lake instead of generated rooms.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same rooms and moves.")
@click.option("--methods", default=",".join(METHODS), show_default=True, help="Methods, with commas between.")
@click.option("--moves-only", is_flag=True, help="Time Algorithm 1 per move, and nothing else.")
@click.option(
    "--processes", type=click.IntRange(1, 256), default=os.cpu_count() or 1, show_default="one per core", help="Worker processes."
)
@json_option
def optimization(rooms: int, address: str | None, seed: int, methods: str, moves_only: bool, processes: int, as_json: bool) -> None:
    """Measure the optimization: rooms before and after each method, side by side, and how long it takes.

    Rooms are furnished by the generator, then disturbed by a rule that no method knows. `drawn` is a room before that,
    `input` after it.

    The exit code is 1 when a goal is missed, 2 when nothing could be measured, and else 0.

    Example: metascenes bench optimization --rooms 5
    """
    context = click.get_current_context()
    for one, other in (("rooms", "address"), ("moves_only", "rooms"), ("moves_only", "address")):
        if all(context.get_parameter_source(name) == ParameterSource.COMMANDLINE for name in (one, other)):
            raise click.UsageError(f"{_OPTIONS[one]} together with {_OPTIONS[other]}: only one of them can be measured; leave one out")
    from flows.bench.optimization import BenchConfig, run_bench, steps_of
    from flows.bench.optimization.tables import print_report
    from flows.progress import Progress

    config = BenchConfig(
        methods=_chosen(methods, METHODS, "--methods"), rooms=rooms, seed=seed, lake=address, moves_only=moves_only, processes=processes
    )
    with Progress("measured", steps_of(config)) as progress:
        report = run_bench(config, progress.advance)
    _tell(report, print_report, as_json)


@command.command("exports")
@click.option("--rooms", type=click.IntRange(1, 10_000), default=20, show_default=True, help="Generated rooms.")
@click.option("--episodes", type=click.IntRange(1, 1000), default=20, show_default=True, help="Episodes per room, for the gates to replay.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same rooms.")
@click.option(
    "--processes", type=click.IntRange(1, 256), default=os.cpu_count() or 1, show_default="one per core", help="Worker processes."
)
@json_option
def exports(rooms: int, episodes: int, seed: int, processes: int, as_json: bool) -> None:
    """Measure the exports: rooms in every format, through every gate, and simulated by nothing but their files.

    What MuJoCo makes of the MJCF, and of the USD by a reader that had no part in writing it, is held against the certificates.

    The exit code is 1 when a goal is missed, and else 0.

    Example: metascenes bench exports --rooms 5
    """
    from flows.bench.exports import ExportsBench, print_exports, run_exports_bench
    from flows.progress import Progress

    with Progress("exported", rooms) as progress:
        report = run_exports_bench(ExportsBench(rooms, seed, processes, episodes), progress.advance)
    _tell(report, print_exports, as_json)


@command.command("navigation")
@click.option("--rooms", type=click.IntRange(1, 10_000), default=10, show_default=True, help="Generated rooms.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same rooms.")
@click.option(
    "--processes", type=click.IntRange(1, 256), default=os.cpu_count() or 1, show_default="one per core", help="Worker processes."
)
@json_option
def navigation(rooms: int, seed: int, processes: int, as_json: bool) -> None:
    """Measure navigation: path finders against each other, against a plain visibility graph, and episodes replayed.

    The path finder `recast` is measured where `make native` has built it.

    The exit code is 1 when a goal is missed, and else 0.

    Example: metascenes bench navigation --rooms 3
    """
    from flows.bench.navigation import NavigationBench, print_navigation, run_navigation_bench
    from flows.progress import Progress

    with Progress("measured", rooms) as progress:
        report = run_navigation_bench(NavigationBench(rooms, seed, processes), progress.advance)
    _tell(report, print_navigation, as_json)


@command.command("warehouse")
@click.option(
    "--scale", "scenes", type=click.IntRange(100), default=100_000, show_default=True,
    help="Scenes of the largest generated lake, 40 objects each; a tenth and a hundredth are measured beside it.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same lake.")
@click.option("--runs", type=click.IntRange(2, 100), default=5, show_default=True, help="Runs of every question after the first.")
@click.option("--parts", default="", help="Measure only these, with commas between: answers, volumes, growth, contention, refusals.")
@json_option
def warehouse(scenes: int, seed: int, runs: int, parts: str, as_json: bool) -> None:
    """Measure the warehouse: how long a large lake takes to answer and to change, what contention does to it, and what it refuses.

    The lakes are generated once and kept in the cache of this machine (METASCENES_CACHE): 100,000 scenes take 5.5 GB and ten
    minutes on two cores. Questions are asked by a process of its own on two cores. The box plot is compared with pandas.

    The exit code is 1 when a goal is missed, 2 when nothing could be measured, and else 0.

    Example: metascenes bench warehouse --scale 1000
    """
    from flows.bench.warehouse.report import PARTS, WarehouseBench, run_warehouse_bench, steps_of
    from flows.bench.warehouse.tables import print_warehouse
    from flows.progress import Progress

    config = WarehouseBench(scenes=scenes, seed=seed, runs=runs, parts=_chosen(parts, PARTS, "--parts"))
    with Progress("measured", steps_of(config)) as progress:
        report = run_warehouse_bench(config, progress.advance)
    _tell(report, print_warehouse, as_json)


@command.command("flows")
@click.option("--scenes", default="10,100,1000", show_default=True, help="Numbers of small scenes to run, with commas between.")
@click.option("--runners", default="pool,processes,dask", show_default=True, help="Runners to compare, with commas between.")
@click.option("--workers", type=click.IntRange(1, 256), default=2, show_default=True, help="Worker processes of every run.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same scenes and kills.")
@click.option("--parts", default="", help="Measure only these, with commas between: startup, overhead, speed, sharing, chaos.")
@click.option("--speed-scenes", type=click.IntRange(4), default=100, show_default=True, help="Scenes that one worker and two are timed on.")
@click.option("--speed-rooms", type=click.IntRange(2), default=6, show_default=True, help="Rooms of about 25 things that they are, too.")
@click.option("--chaos-scenes", type=click.IntRange(1), default=50, show_default=True, help="Scenes of the run that is disturbed.")
@click.option("--kills", type=click.IntRange(0), default=12, show_default=True, help="How many times something is killed in it.")
@json_option
def flows(scenes: str, runners: str, workers: int, seed: int, parts: str, speed_scenes: int, speed_rooms: int, chaos_scenes: int,
          kills: int, as_json: bool) -> None:  # fmt: skip
    """Measure the flows: what orchestration costs, two workers beside one, memory, two runs at once, and chaos.

    Small scenes are run by `metascenes run` as anybody would; all seven stages of one take about half a second. Chaos kills
    workers, runs, the Prefect server and its PostgreSQL at random, and needs PostgreSQL's programs (Debian: postgresql).

    The exit code is 1 when a goal is missed, 2 when nothing could be measured, and else 0.

    Example: metascenes bench flows --scenes 10,100 --runners pool
    """
    from flows.bench.flows.report import PARTS, RUNNERS, FlowsBench, run_flows_bench, steps_of
    from flows.bench.flows.tables import print_flows
    from flows.progress import Progress

    config = FlowsBench(
        scenes=_numbers(scenes, "--scenes"), runners=_chosen(runners, RUNNERS, "--runners"), workers=workers, seed=seed,
        parts=_chosen(parts, PARTS, "--parts"), speed_scenes=speed_scenes, speed_rooms=speed_rooms,
        chaos_scenes=chaos_scenes, kills=kills,
    )  # fmt: skip
    with Progress("measured", steps_of(config)) as progress:
        report = run_flows_bench(config, progress.advance)
    _tell(report, print_flows, as_json)


@command.command("scale")
@click.option("--things", default="100,300,1000", show_default=True, help="Numbers of things in one scene, with commas between.")
@click.option("--scenes", default="30,100,300", show_default=True, help="Numbers of near-empty scenes, with commas between.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same scenes.")
@json_option
def scale(things: str, scenes: str, seed: int, as_json: bool) -> None:
    """Measure what grows with the things of a scene and with the number of scenes: seconds and memory of every stage.

    With three sizes or more, the power of the size is told that a stage's processor seconds grow with. Every stage does its own work,
    on little, as in `metascenes bench flows`; a thousand things take about ten minutes of a processor.

    The exit code is 1 when something grows faster than linearly, 2 when a size did not go through, and else 0.

    Example: metascenes bench scale --things 10,30,100 --scenes 3,10,30
    """
    from flows.bench.flows.scale import ScaleBench, run_scale_bench
    from flows.bench.flows.tables import print_scale
    from flows.progress import Progress

    config = ScaleBench(_numbers(things, "--things"), _numbers(scenes, "--scenes"), seed)
    with Progress("measured", len(config.things) + len(config.scenes)) as progress:
        report = run_scale_bench(config, progress.advance)
    _tell(report, print_scale, as_json)


@command.command("chaos")
@click.option("--kills", type=click.IntRange(1), default=1000, show_default=True, help="Stop after so many kills.")
@click.option("--minutes", type=click.FloatRange(min=0), default=120.0, show_default=True, help="Begin no batch after so many minutes.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same stories and kills.")
@click.option("--kinds", default="", help="Only these, with commas between: lake, writers, clock, clock writers, disk, runs, configs.")
@click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False), default=Path("chaos"), show_default=True,
    help="Where the journal is kept, from which the same command goes on.",
)  # fmt: skip
@json_option
def chaos(kills: int, minutes: float, seed: int, kinds: str, folder: Path, as_json: bool) -> None:
    """Kill whatever works on small lakes, in batches, and hold each lake against one that nobody disturbed.

    SIGKILL hits scenes' workers, commits, compactions, vacuums, releases, erasures, backups, restores and imports of annotations
    before chosen steps and at random moments; eight writers and upkeep at once; runs, their workers, and two runs of different
    settings on one lake. Clocks are wrong and jump (Debian: libfaketime), disks are full (wants root, to mount small ones).

    The exit code is 1 when a batch found a fault, 2 when a kind cannot be done here, and else 0.

    Example: metascenes bench chaos --kills 100 --minutes 10 --kinds lake,writers
    """
    from flows.bench.kills.campaign import KINDS, Campaign, run_campaign
    from flows.bench.kills.tables import print_campaign
    from flows.progress import Progress

    with Progress("kills", kills) as progress:
        report = run_campaign(Campaign(folder, kills, minutes, seed, _chosen(kinds, KINDS, "--kinds")), progress.advance)
    _tell(report, print_campaign, as_json)


def _numbers(text: str, option: str) -> tuple[int, ...]:
    """Numbers from 1 with commas between."""
    words = _words(text)
    if not words or not all(word.isdigit() and int(word) for word in words):
        raise click.BadParameter(f"{text!r} is no list of numbers from 1", param_hint=option)
    return tuple(map(int, words))


def _words(text: str) -> tuple[str, ...]:
    """Words with commas between, each once."""
    return tuple(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))


def _chosen(text: str, known: tuple[str, ...], option: str) -> tuple[str, ...]:
    """Words with commas between, each of which must be known; all that are known where there are none."""
    words = _words(text) or known
    unknown = [word for word in words if word not in known]
    if unknown:
        raise click.BadParameter(f"{unknown[0]!r} is none of {', '.join(known)}", param_hint=option)
    return words


def _tell(report: dict[str, Any], show: Callable[[Mapping[str, Any], Console], None], as_json: bool) -> None:
    """Print a report; exit code 1 when a goal is missed."""
    if as_json:
        print(json.dumps(_finite(report), allow_nan=False))
    else:
        from rich.console import Console

        from flows.terminal import drawn

        show(report, Console(file=drawn(sys.stdout), highlight=False, width=None if sys.stdout.isatty() else 120))
    if any(goal["met"] is False for goal in report["goals"]):
        click.get_current_context().exit(1)


def _finite(value: Any) -> Any:
    """The same with null for numbers that are none: a thing without a certificate moved by nobody knows how much."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
