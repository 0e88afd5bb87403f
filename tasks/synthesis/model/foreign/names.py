"""What checkpoints of all upstreams have in common: the frame, and names that nobody knows or that are missing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError

AXES = ("z", "x", "y")
"""Their axis for each of ours."""

SHOWN_NAMES = 5

Arrays = Mapping[str, NDArray[Any]]


def turned(places: NDArray[np.int64], first: int) -> None:
    """Bring places (n, ...) of three numbers of a triple, of which `first` is that of their x, into our order; in place."""
    places[first : first + 3] = places[[first + "xyz".index(letter) for letter in AXES]]


def check_names(given: Iterable[str], known: Iterable[str], file: str, upstream: str) -> None:
    """Refuse a checkpoint of other weights. known: Names that it must have. upstream: What the file should be of, for the error.

    Raises:
        InputError: some names are not known, or are missing.
    """
    have, wanted = {*given}, {*known}
    for odd, problem in ((sorted(have - wanted), "are unknown"), (sorted(wanted - have), "are missing")):
        if odd:
            shown = ", ".join(odd[:SHOWN_NAMES]) + (f" and {len(odd) - SHOWN_NAMES} more" if len(odd) > SHOWN_NAMES else "")
            raise InputError(file, odd[0], f"{len(odd)} of its weights {problem}: {shown}", f"name a checkpoint of {upstream} of this size")


def wrong_shape(file: str, name: str, shape: tuple[int, ...], wanted: object) -> InputError:
    """The refusal of an array. wanted: The shape that it should have."""
    return InputError(
        file, name, f"has the shape {shape}; the config wants {wanted}", "take a config of its size: slots, classes, texts and architecture"
    )
