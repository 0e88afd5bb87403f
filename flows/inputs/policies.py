"""Trained policies by name: which model acts, and what makes it act in a scene of the lake."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

from flows.run.fingerprints import code_fingerprint, digest
from flows.simulation.scenes import Worlds
from flows.training.contents import contents_of
from flows.training.models import LIST, found_model, listed_models, loaded_model
from schemas.errors import InputError
from schemas.families.policies import POLICIES
from schemas.navigation import Episode
from tasks.evaluation.batch import Attempt
from tasks.evaluation.configuration import EvaluationConfig
from tasks.policy.inference.actor import Actor, load_model
from tasks.policy.model.config import PolicyModel
from tasks.policy.rollout import rolled_out
from tasks.settings import nearest
from warehouse.lake import Lake
from warehouse.tables.snapshot import Reader

SYSTEM = "navigation"
"""The learned system whose models navigate."""

ACTING_CODE = "tasks.policy.rollout"
"""The module that lets a model act."""


@dataclasses.dataclass(frozen=True)
class TrainedPolicy:
    """A model that navigates. code: Fingerprint of the code that acts, and of the weights of others that it acts with."""

    model_id: str
    code: str
    actor: Actor

    @property
    def run_name(self) -> str:
        """Of its trajectories: the beginning of its id, by which `metascenes models` finds it."""
        return self.model_id[:12]

    def act(self, lake: Lake, reader: Reader, scene_id: str, episodes: Sequence[Episode], config: EvaluationConfig) -> tuple[Attempt, ...]:
        """What it does in episodes of one scene.

        Raises:
            InputError: the scene lacks what an agent needs.
        """
        made: list[Attempt] = []
        for agent in sorted({episode.agent for episode in episodes}):
            world = Worlds(lake, reader, agent, config.reach_m).world(scene_id)
            made += rolled_out(world, self.actor, [episode for episode in episodes if episode.agent == agent], config)
        order = {episode.episode_id: number for number, episode in enumerate(episodes)}
        return tuple(sorted(made, key=lambda attempt: order[attempt.episode_id]))


def trained_policy(lake: Lake, wanted: str) -> TrainedPolicy:
    """The policy that a text means: `navigation`, of which the newest is taken that was trained in or imported into the lake and not
    withdrawn, else the one that ships; or a model's id, or the beginning of one, or the name of one that ships.

    Raises:
        InputError: there is none, or the named one was withdrawn.
    """
    reader = lake.snapshot()
    models = [(row, name) for row, name in listed_models(reader) if row.kind == SYSTEM]
    if wanted == SYSTEM:
        rows = [row for row, _ in models if not row.is_withdrawn]
        if not rows:
            raise InputError(
                "--policy", wanted, "no policy was trained in this lake, and none ships", f"`metascenes train {SYSTEM}` makes one"
            )
        row = rows[0]
    else:
        if not re.fullmatch(r"[0-9a-f]{4,64}", wanted) and wanted not in {name for _, name in models}:
            raise InputError("--policy", wanted, "is no policy", nearest(wanted, (*POLICIES, SYSTEM), "give a model's id, or one of"))
        row, _ = found_model(reader, wanted, SYSTEM)
        if row.is_withdrawn:
            raise InputError("--policy", wanted, "was withdrawn", f"name another; {LIST}")
    actor = load_model(loaded_model(lake, row))
    return TrainedPolicy(row.model_id, digest(code_fingerprint(ACTING_CODE), *contents_of(_foreign(actor.config))), actor)


def _foreign(config: PolicyModel) -> dict[str, str]:
    """Weights of others that a policy sees and reads with, by field."""
    named = {name: getattr(getattr(config, name), "weights", "") for name in ("eyes", "goal")}
    return {name: path for name, path in named.items() if path}
