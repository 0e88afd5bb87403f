"""`metascenes bench`: what our claims about quality and speed rest on, measured again on any machine."""

from __future__ import annotations

import json
import math
import os
import sys
from typing import Any

import click
from click.core import ParameterSource

from flows.commands.options import json_option

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

    chosen = tuple(dict.fromkeys(word.strip() for word in methods.split(",")))
    unknown = [word for word in chosen if word not in METHODS]
    if unknown:
        raise click.BadParameter(f"{unknown[0]!r} is none of {', '.join(METHODS)}", param_hint="--methods")
    config = BenchConfig(methods=chosen, rooms=rooms, seed=seed, lake=address, moves_only=moves_only, processes=processes)
    with Progress("measured", steps_of(config)) as progress:
        report = run_bench(config, progress.advance)
    if as_json:
        print(json.dumps(_finite(report), allow_nan=False))
    else:
        from rich.console import Console

        print_report(report, Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else 120))
    if any(goal["met"] is False for goal in report["goals"]):
        context.exit(1)


def _finite(value: Any) -> Any:
    """The same with null for numbers that are none: a thing without a certificate moved by nobody knows how much."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
