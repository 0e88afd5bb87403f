"""What commands that measure share: lists on the command line, a progress bar before the report, and the exit code of goals."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import click

from schemas.wording import meant

if TYPE_CHECKING:
    from rich.console import Console

processes_option = click.option(
    "--processes", type=click.IntRange(1, 256), default=os.cpu_count() or 1, show_default="one per core", help="Worker processes."
)

Show = Callable[[Mapping[str, Any], "Console"], None]


def listed_numbers(text: str, option: str) -> tuple[int, ...]:
    """Numbers from 1 with commas between."""
    words = listed_words(text)
    if not words or not all(word.isdigit() and int(word) for word in words):
        raise click.BadParameter(f"{text!r} is no list of numbers from 1", param_hint=option)
    return tuple(map(int, words))


def listed_words(text: str) -> tuple[str, ...]:
    """Words with commas between, each once."""
    return tuple(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))


def chosen_words(text: str, known: tuple[str, ...], option: str) -> tuple[str, ...]:
    """Words with commas between, each of which must be known; all that are known where there are none."""
    words = listed_words(text) or known
    unknown = [word for word in words if word not in known]
    if unknown:
        raise click.BadParameter(
            f"{unknown[0]!r} is none of {', '.join(known)}; {meant(unknown[0], known)}".rstrip("; "), param_hint=option
        )
    return words


def run_measurement(label: str, steps: int, run: Callable[[Callable[[str], None]], dict[str, Any]], show: Show, as_json: bool) -> None:
    """Run a benchmark behind a progress bar of so many steps, and print its report; exit code 1 when a goal is missed."""
    from flows.progress import Progress

    with Progress(label, steps) as progress:
        report = run(progress.advance)
    if as_json:
        print(json.dumps(finite(report), allow_nan=False))
    else:
        from rich.console import Console

        from flows.terminal import drawn

        show(report, Console(file=drawn(sys.stdout), highlight=False, width=None if sys.stdout.isatty() else 120))
    if any(goal["met"] is False for goal in report["goals"]):
        click.get_current_context().exit(1)


def finite(value: Any) -> Any:
    """The same with null for numbers that are none: an object without a certificate moved by nobody knows how much."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
