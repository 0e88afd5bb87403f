"""Which global concurrency limit of the Prefect server keeps stages from computing on a graphics card at once.

A card has one limit, of as many slots as stages may use it at once. It counts use, not memory: a worker keeps its networks on the card
between scenes, so that a card holds as many sets as workers use it. The limit is that of the server, so it counts over all runs and
machines; machines with cards of their own go by servers, or by limits, of their own.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping
from typing import Any

from flows.run.limits import limit_of

GPU = "metascenes-gpu"
"""The limit of the first graphics card; those of further ones end in their number: `metascenes-gpu-1`."""


def card_limit(number: int) -> str:
    """The limit of a graphics card by its number, from 0."""
    return f"{GPU}-{number}" if number else GPU


def device_limits(stages: Mapping[str, Any]) -> dict[str, str]:
    """The limit of the card that each stage's networks run on, by stage; stages that use none are left out.

    stages: Their settings, by stage. `auto` counts as the first card. A stage that uses several cards goes by the first of them.
    """
    cards = {stage: min(_cards(settings), default=None) for stage, settings in stages.items()}
    return {stage: card_limit(card) for stage, card in cards.items() if card is not None}


def with_devices(limits: Mapping[str, str], stages: Mapping[str, Any]) -> dict[str, str]:
    """Limits by stage, with those of graphics cards for stages that use one and have no other limit, as far as the server has them."""
    wanted = {stage: name for stage, name in device_limits(stages).items() if stage not in limits}
    there = {name for name in set(wanted.values()) if limit_of(name) is not None}
    return {**limits, **{stage: name for stage, name in wanted.items() if name in there}}


def _cards(settings: Any) -> Iterator[int]:
    """Numbers of the graphics cards that settings put weights on."""
    if isinstance(settings, tuple | list):
        for item in settings:
            yield from _cards(item)
    if not dataclasses.is_dataclass(settings):
        return
    device = getattr(settings, "device", None)
    if isinstance(device, str) and getattr(settings, "weights", None):
        card = re.fullmatch(r"auto|cuda(?::(\d+))?", device)
        if card is not None:
            yield int(card[1] or 0)
    for field in dataclasses.fields(settings):
        yield from _cards(getattr(settings, field.name))
