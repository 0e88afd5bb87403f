"""The learned system `navigation`: what an agent does next on its way to an object, learned from shortest paths (supplementary B.3)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar

from schemas.errors import InputError
from tasks.models import folders_in
from tasks.policy.augmentation import PictureAugmentation
from tasks.policy.collection import READS, CollectedWalks, collected, held_out, spread
from tasks.policy.corrections import CorrectionsConfig, agreement, corrected
from tasks.policy.demonstrations import AgentWalk, WalkConfig, majority
from tasks.policy.figures import figures_of, predictions_of
from tasks.policy.inference.actor import load
from tasks.policy.model.config import AnyPolicy, OwnEyes, OwnGoal, PolicyModel, SiglipEyes, SiglipGoal, SmallPolicy, config_from
from tasks.policy.model.foreign import begin_with_foreign
from tasks.policy.model.frozen import begin_with_states, is_frozen
from tasks.policy.model.objective import PolicyBatchConfig, PolicyObjective, seen_on
from tasks.policy.model.presets import PRESETS
from tasks.policy.model.shapes import VOCABULARY, Vocabulary, check_fit, vocabulary_in, vocabulary_of
from tasks.policy.sight import SceneRenderer
from tasks.policy.store import Render, Store
from tasks.settings import Config, Count, Natural, NonNegative, Share
from tasks.stage import Context
from tasks.training.dataset import Dataset
from tasks.training.fitting import Betas, Fitted, FittingConfig, check_installed, fit, seed_of, seeded, weights_of
from tasks.training.system import LearnedSystem
from tasks.training.trained import Measure, StepLoss, Trained
from tasks.weights import from_safetensors, to_safetensors

SHIPPED = Path(__file__).parents[2] / "policy" / "model" / "shipped"

EYES_MEMORY = "tasks.policy.model.frozen"
"""The module in whose cache tokens of pictures lie."""


@dataclasses.dataclass(frozen=True)
class PolicyFitting(FittingConfig):
    """How long and how fast it is fitted."""

    steps: Count = 3000  # of 64 windows (specs E.4): some twenty minutes on one busy processor
    warmup_steps: Natural = 100  # attention from scratch wants more than the usual 50
    weight_decay: NonNegative = 0.01  # AdamW's own; as published
    validate_steps: Count = 250  # looking at held-out walks takes as long as some steps
    record_steps: Count = 20  # losses of single steps jump with the walks


@dataclasses.dataclass(frozen=True)
class NavigationTraining(Config):
    """What is trained, and how."""

    kind: ClassVar[str] = "navigation"
    model: AnyPolicy = dataclasses.field(default_factory=SmallPolicy)  # trains here, and acts without torch
    walks: WalkConfig = dataclasses.field(default_factory=WalkConfig)  # the paper's robot and numbers of trajectories
    batch: PolicyBatchConfig = dataclasses.field(default_factory=PolicyBatchConfig)  # 64 windows a step
    augmentation: PictureAugmentation = dataclasses.field(default_factory=PictureAugmentation)  # as published
    corrections: CorrectionsConfig = dataclasses.field(default_factory=CorrectionsConfig)  # none, as published
    fitting: PolicyFitting = dataclasses.field(default_factory=PolicyFitting)
    foreign: str = ""  # file of weights of SPOC to begin with; none: from scratch
    half: bool = True  # weights are kept at half precision, and figures are of these
    validation_share: Share = 0.1  # of the training rooms, to see that nothing is learned by heart
    validation_walks: Count = 100  # at most, that the best weights are chosen by; figures are of all
    test_share: Share = 0.2  # of the rooms, where `splits` has no row; as navigation has it


PAPER_BETAS: Betas = (0.9, 0.999)

PAPER_FITTING = PolicyFitting(
    steps=70_000, learning_rate=1e-4, final_learning_rate=1e-4, warmup_steps=0, weight_decay=0.01, betas=PAPER_BETAS, validate_steps=1000,
    record_steps=100, checkpoint_steps=500,
)  # fmt: skip
"""AdamW at one step size for 70,000 steps, as printed in the supplementary; what is not printed there is AdamW's own."""


def preset(name: str, fitting: PolicyFitting | None = None) -> NavigationTraining:
    """The settings of a preset, with its budget or another one.

    Raises:
        KeyError: there is none of that name.
    """
    model = PRESETS[name]
    if isinstance(model, SmallPolicy):
        return NavigationTraining(model, fitting=fitting or PolicyFitting())
    batch = PolicyBatchConfig(windows=256, last_dropout=0.0, stop_weight=1.0, unknown_share=0.0)
    return NavigationTraining(
        model, batch=batch, augmentation=PictureAugmentation(versions=1), fitting=fitting or PAPER_FITTING
    )  # fmt: skip


def train(*, dataset: Dataset, start: bytes | None, context: Context, config: NavigationTraining) -> Trained:
    """A policy of the episodes of a dataset; no room is on two sides, and figures are of the weights as they are kept.

    With weights to begin with, the goals that these know keep their places, and further ones follow.

    Raises:
        InputError: there is no episode, weights to begin with do not fit, or packages or folders of weights are not there.
        Diverged: the loss is no finite number any more.
    """
    check_installed()
    check_versions(config)
    data = collected(dataset, context, config.walks, config.test_share)
    return trained_on(data, sight_of(data, context, config.model), start, context, config)


def sight_of(data: CollectedWalks, context: Context, model: PolicyModel) -> Render:
    """What renders the scenes of a dataset."""
    return SceneRenderer(data.looks, data.assets, context.blobs, model)


def trained_on(data: CollectedWalks, render: Render, start: bytes | None, context: Context, config: NavigationTraining) -> Trained:
    """A policy of walks, whose pictures `render` gives. Raises as `train`."""
    from tasks.policy.model.acting import begin_with

    model = config.model
    learning, held = held_out(data.train, config.validation_share)
    splits = {"train": learning, "validation": held, "test": data.test}
    module, vocabulary, notes = beginning(learning, start, context, config)
    notes = [*notes_of(data, splits, vocabulary, config), *notes]
    memory = context.caches[EYES_MEMORY]

    def store(walks: Sequence[AgentWalk], number: int) -> Store:
        seed = seed_of(context.seed, "store", number)
        return Store(walks, render, model, config.augmentation, memory, config.batch.store_mb, config.batch.part_steps, seed)

    total = config.fitting.steps + config.corrections.rounds * config.corrections.steps
    fits: list[Fitted] = []
    visited: list[AgentWalk] = []
    shown = store(learning, 0)
    for number in range(config.corrections.rounds + 1):
        fitting, key = config.fitting, context.scene_id
        if number:
            state = fits[-1].state_dict
            module.load_state_dict(state)
            courses = {name: course for name, course in data.courses.items() if any(walk.scene_id == name for walk in learning)}
            actor = load(kept(state, vocabulary, half=False), model)
            walked = corrected(actor, courses, render, config.walks, config.corrections, number, context.seed)
            notes.append(f"round {number}: {len(walked)} walks of its own, right in {agreement(walked):.0%} of steps")
            visited += walked
            fitting = dataclasses.replace(fitting, steps=config.corrections.steps)
            key = f"{context.scene_id}-round{number}"
        objective = PolicyObjective(
            shown, store(visited, 1), spread(held, config.validation_walks), model, config.batch, vocabulary,
            seed_of(context.seed, "batches", number),
        )  # fmt: skip
        fits.append(
            fit(
                module, objective, fitting, seed=seed_of(context.seed, "round", number), key=key,
                checkpoints=context.caches["tasks.training.fitting"], report=_further(context, sum(f.steps[-1].step for f in fits), total),
            )
        )  # fmt: skip
    weights = kept(fits[-1].state_dict, vocabulary, half=config.half)
    begin_with(module, from_safetensors(weights))
    module.cpu().eval()
    measures: list[Measure] = []
    most = majority(learning)
    for split in ("validation", "test"):
        if splits[split]:
            predictions = predictions_of(module, splits[split], seen_on(splits[split], shown), vocabulary)
            measures += [
                Measure("", split, metric, share.value, share.low, share.high, share.examples, method)
                for method, metric, share in figures_of(predictions, most, context.seed)
            ]
    return Trained(
        architecture=model.kind,
        weights=weights,
        parameter_count=sum(parameter.numel() for parameter in module.parameters()),
        steps=tuple(curve(fits)),
        measures=tuple(measures),
        examples={split: len(walks) for split, walks in splits.items()},
        license=data.license,
        is_fallback=(isinstance(model.eyes, OwnEyes) and not model.blind) or isinstance(model.goal, OwnGoal),
        notes=tuple(notes),
        device=fits[-1].device,
        seconds=sum(f.seconds for f in fits),
    )


def beginning(
    learning: Sequence[AgentWalk], start: bytes | None, context: Context, config: NavigationTraining
) -> tuple[Any, Vocabulary, list[str]]:
    """The network before its first step, the goals that it knows, and what is said of where its weights come from.

    Raises:
        InputError: weights to begin with do not fit, or folders of weights are not there.
    """
    from tasks.policy.model.acting import begin_with

    model = config.model
    arrays = None if start is None else from_safetensors(start)
    known = () if arrays is None else vocabulary_in(arrays)
    seen = vocabulary_of(walk.category for walk in learning)
    vocabulary = Vocabulary((*known, *(goal for goal in seen if goal not in known)))
    module, notes = network(model, len(vocabulary), context.seed), []
    if config.foreign:
        notes.append(begin_with_foreign(module, config.foreign))
    if arrays is not None:
        check_fit(arrays, model, "start")
        state = {name: tensor.numpy() for name, tensor in module.state_dict().items()}
        for name in ("goal.vectors.weight", "goal.states"):  # those of further goals stay as they were drawn
            if name in arrays:
                state[name][: len(known)] = arrays[name]
        begin_with(module, {**arrays, **{name: state[name] for name in ("goal.vectors.weight", "goal.states") if name in arrays}})
    if isinstance(model.goal, SiglipGoal) and set(vocabulary) - set(known) - {""}:
        begin_with_states(module, vocabulary, model.goal, known)
    return module, vocabulary, notes


def network(model: PolicyModel, goals: int, seed: int) -> Any:
    """A network whose first weights follow from the seed."""
    from tasks.policy.model.networks.policy import PolicyNet

    with seeded(seed, "navigation", "weights"):
        return PolicyNet(model, goals)


def kept(state: Any, vocabulary: Vocabulary, *, half: bool) -> bytes:
    """Weights as they are kept, the goals that they know among them."""
    return to_safetensors({**from_safetensors(weights_of(state, half=half)), VOCABULARY: vocabulary.array()})


def curve(fits: Sequence[Fitted]) -> list[StepLoss]:
    """Points of one curve after another."""
    points: list[StepLoss] = []
    for fitted in fits:
        before = points[-1].step if points else 0
        points += [dataclasses.replace(point, step=before + point.step) for point in fitted.steps]
    return points


def _further(context: Context, before: int, total: int) -> Callable[[int, int, str], None]:
    """The context's report, of steps after those before."""

    def report(done: int, of: int, text: str) -> None:
        context.report(before + done, total, text)

    return report


def check_versions(config: NavigationTraining) -> None:
    """Refuse to have frozen eyes look at pictures that are changed anew each time. Raises `InputError`."""
    if is_frozen(config.model) and not config.augmentation.versions:
        problem = "is 0, and frozen eyes would encode every picture anew in every step"
        raise InputError("train navigation", "system.augmentation.versions", problem, "set it to 1, or some more")


def notes_of(
    data: CollectedWalks, splits: dict[str, list[AgentWalk]], vocabulary: Vocabulary, config: NavigationTraining
) -> list[str]:  # fmt: skip
    """What must be known of a policy: what was left out, what stands in, and where it is not as published."""
    model = config.model
    notes = [f"{count} episodes left out: {reason}" for reason, count in sorted(data.left_out.items())]
    for split in ("validation", "test"):
        strange = {walk.category for walk in splits[split]} - set(vocabulary)
        if strange:
            count = sum(walk.category in strange for walk in splits[split])
            notes.append(f"{count} walks ({split}) lead to things that no training room has an episode for, and count as unknown")
    if model.blind:
        notes.append("blind: it sees no pictures")
    elif isinstance(model.eyes, OwnEyes):
        notes.append("eyes: layers of ours, trained with the rest, stand in for SigLIP; name weights to have that")
    if model.senses_depth or model.senses_goal:
        senses = ["depth"] * model.senses_depth + ["which pixels show what it is sent to"] * model.senses_goal
        notes.append(f"not as published: it is told {' and '.join(senses)}, by the simulator's cameras")
    if model.goalless:
        notes.append("goalless: it is not told what it is sent to")
    if isinstance(model.goal, OwnGoal):
        notes.append("goal: learned vectors of categories stand in for SigLIP's texts; name weights to have those")
    if config.batch.last_dropout:
        notes.append(f"not as published: {config.batch.last_dropout:.0%} of last actions are not told in training")
    if config.batch.stop_weight != 1:
        notes.append(f"not as published: steps that should stop count {config.batch.stop_weight:g} times")
    if config.corrections.rounds:
        notes.append(f"not as published: {config.corrections.rounds} rounds of corrections of its own mistakes")
    return notes


def fits(weights: bytes, config: NavigationTraining, file: str) -> None:
    """Hold the weights of a model by others against its config. Raises `InputError` as `check_fit`."""
    check_fit(from_safetensors(weights, file), config.model, file)


def paths(config: NavigationTraining) -> dict[str, str]:
    """Foreign weights that a config names, by field."""
    named = {"foreign": config.foreign}
    for field in ("eyes", "goal"):
        part = getattr(config.model, field)
        named[f"model.{field}.weights"] = part.weights if isinstance(part, SiglipEyes | SiglipGoal) else ""
    return {field: path for field, path in named.items() if path}


def continues(start: str, config: NavigationTraining, file: str) -> None:
    """Refuse to go on from a policy that senses something else: depth and goal fit into one another's place. Raises `InputError`."""
    before, now = config_from(start), config.model
    for field in ("blind", "senses_depth", "senses_goal"):
        if getattr(before, field) != getattr(now, field):
            problem = f"is {str(getattr(before, field)).lower()} of it, and {str(getattr(now, field)).lower()} of what is to be trained"
            raise InputError(file, field, problem, "set training.system.model to sense the same")


NAVIGATION = LearnedSystem(
    name="navigation",
    config=NavigationTraining,
    reads=READS,
    train=train,
    shipped=lambda: folders_in(SHIPPED),
    fits=fits,
    paths=paths,
    continues=continues,
)
