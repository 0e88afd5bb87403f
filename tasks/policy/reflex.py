"""What an agent does that runs against something: it turns aside, farther each time, and steps on, whatever its policy would rather repeat.

A policy that tells the likeliest action from what it sees goes on with it for as long as it sees the same: right before a chair leg that is
below the picture it steps forward until its steps are used up. A picture that is the same to the last byte after a step forward says that
the step led nowhere, and no other sense is needed for that. It is wrong where nothing near is in the picture: an agent that walks squarely
to a bare wall farther away than its depth reaches turns aside, too. Policies without pictures have no such reflex.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tasks.policy.actions import FORWARD, LEFT, RIGHT, START, STOP

MOST_TURNS = 5
"""In a row, after as many runs against things: with the one that the policy may add, all the way to behind."""

FORGOTTEN = 12
"""Steps without running against anything, after which it begins with one turn again: once around."""

Actions = NDArray[np.int64]


class Reflex:
    """The reflexes of n agents."""

    def __init__(self, n: int) -> None:
        self._pictures: NDArray[np.uint8] | None = None
        self._last = np.full(n, START, dtype=np.int64)
        self._runs = np.zeros(n, dtype=np.int64)  # against things, lately
        self._calm = np.zeros(n, dtype=np.int64)  # steps since the last one
        self._side = np.full(n, LEFT, dtype=np.int64)  # that it turns to
        self._turns = np.zeros(n, dtype=np.int64)  # that are left to make
        self._steps = np.zeros(n, dtype=np.bool_)  # whether a step forward follows them

    def keep(self, agents: ArrayLike) -> None:
        """Go on with some agents alone, by their places, shape (m,): theirs are 0 to m - 1 from now on."""
        places = np.asarray(agents, dtype=np.int64).reshape(-1)
        for name in ("_last", "_runs", "_calm", "_side", "_turns", "_steps"):
            setattr(self, name, getattr(self, name)[places])
        if self._pictures is not None:
            self._pictures = self._pictures[places]

    def chosen(self, logits: NDArray[np.float32], pictures: NDArray[np.uint8]) -> Actions:
        """What each agent does, shape (n,): the likeliest action, or what its reflex says. Who wants to stop may.

        Args:
            logits: How likely actions are to the policy, shape (n, a).
            pictures: What each sees, shape (n, h, w, c).
        """
        actions: Actions = logits.argmax(axis=-1).astype(np.int64)
        ran = np.zeros(len(actions), dtype=np.bool_)
        if self._pictures is not None:
            ran = (self._last == FORWARD) & (pictures == self._pictures).all(axis=(1, 2, 3))
        first = ran & (self._runs == 0)
        self._side[first] = np.where(logits[first, LEFT] >= logits[first, RIGHT], LEFT, RIGHT)
        self._runs[ran] += 1
        self._calm = np.where(ran, 0, self._calm + 1)
        self._runs[self._calm > FORGOTTEN] = 0
        self._turns[ran] = np.minimum(self._runs[ran], MOST_TURNS)
        self._steps[ran] = self._runs[ran] > 1
        turning, stepping = self._turns > 0, (self._turns == 0) & self._steps
        wanted = actions != STOP
        self._turns[turning] -= 1
        self._steps[stepping] = False
        actions[turning & wanted] = self._side[turning & wanted]
        actions[stepping & wanted] = FORWARD
        self._last, self._pictures = actions.copy(), pictures.copy()
        return actions
