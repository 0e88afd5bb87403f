"""A policy that needs no training: it does what the expert does, where it is not told to fail."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from flows.evaluation import acting
from schemas.navigation import Episode
from tasks.evaluation.batch import Attempt
from tasks.evaluation.policies import POLICIES
from tasks.families import member
from tests.samples import fingerprint


@dataclasses.dataclass(frozen=True)
class ExpertStandIn:
    """What `trained_policy` gives. fails: What is raised, by scene."""

    model_id: str
    fails: Mapping[str, Exception]
    code: str = fingerprint("code")

    @property
    def run_name(self) -> str:
        return self.model_id[:12]

    def act(self, lake: Any, reader: Any, scene_id: str, episodes: Sequence[Episode], config: Any) -> Sequence[Attempt]:
        if scene_id in self.fails:
            raise self.fails[scene_id]
        return tuple(member(POLICIES, "expert").act(episodes, config, lambda *words: np.random.default_rng(0)))


def let_experts_act(patched: pytest.MonkeyPatch, fails: Mapping[str, Mapping[str, Exception]]) -> None:
    """Models act as experts from now on; `fails` says for some of them what is raised in which scene."""
    patched.setattr(acting, "trained_policy", lambda lake, wanted: ExpertStandIn(wanted, fails.get(wanted, {})))
    patched.setattr(acting, "_loaded", lambda address, model_id: ExpertStandIn(model_id, fails.get(model_id, {})))
