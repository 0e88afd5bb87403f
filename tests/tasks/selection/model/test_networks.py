"""What must hold of the networks, their losses and their batches, whatever the weights."""

from __future__ import annotations

import dataclasses
import itertools
import math
import pickle

import numpy as np
import pytest

from tasks.selection.model.batches import (
    BatchConfig,
    SelectionObjective,
    chosen_objects,
    others_of,
    predicted,
    training_batch,
)
from tasks.selection.model.config import AugmentationConfig, NoQuery, OwnText, PointNet2, SelectionModel, Uni3d
from tasks.selection.model.examples import by_room
from tasks.selection.model.features import features_of
from tasks.training.fitting import FittingConfig, fit
from tasks.training.systems.selection import freeze, network
from tests.tasks.selection.model.shapes import toy
from tests.tasks.selection.model.test_inference import FULL, SWITCHES

torch = pytest.importorskip("torch")

POINTNET2 = PointNet2(
    points=48,
    centers=(16, 8),
    samples=(8, 6),
    first_widths=(8, 12),
    second_widths=(16,),
    third_widths=(24,),
    last_widths=(20,),
    embedding=12,
    head_width=8,
)
UNI3D = Uni3d(
    points=48,
    groups=8,
    group_size=6,
    dim=24,
    depth=2,
    heads=4,
    mlp_width=32,
    first_widths=(8, 16),
    second_widths=(16, 24),
    position_width=8,
    embedding=20,
    head_width=8,
)
ALL = SWITCHES | {"pointnet2": {"architecture": POINTNET2}, "uni3d": {"architecture": UNI3D}}


def made(config: SelectionModel, seed: int = 0):
    return network(config, seed).eval()


@pytest.mark.parametrize("switch", ALL)
def test_permuted_candidates_have_permuted_scores_and_missing_ones_change_nothing(switch: str) -> None:
    config = dataclasses.replace(FULL, **ALL[switch])
    examples, clouds = toy(2, 5, points=64)
    model = made(config)
    order = np.random.default_rng(0).permutation(10)
    turned = dataclasses.replace(examples[0], candidates=tuple(examples[0].candidates[i] for i in order))
    plain, mixed = predicted(model, [examples[0]], clouds)[0], predicted(model, [turned], clouds)[0]
    assert np.allclose(plain[order], mixed, atol=1e-5)
    few = dataclasses.replace(examples[0], candidates=examples[0].candidates[:4])
    alone, beside = predicted(model, [few], clouds)[0], predicted(model, [few, examples[1]], clouds)[0]
    assert np.allclose(alone, beside, atol=1e-5)


def test_a_missing_image_changes_nothing_of_others_and_counts_for_nothing() -> None:
    examples, clouds = toy(2, 6, points=64)
    model = made(FULL)
    blind = dataclasses.replace(examples[1], scanned=dataclasses.replace(examples[1].scanned, image=None))
    both, one = predicted(model, examples, clouds), predicted(model, [examples[0], blind], clouds)
    assert np.allclose(both[0], one[0], atol=1e-5)
    assert not np.allclose(both[1], one[1], atol=1e-3)
    without = predicted(made(dataclasses.replace(FULL, image=NoQuery())), [blind], clouds)
    with torch.no_grad():
        other = made(dataclasses.replace(FULL, image=NoQuery()))
        other.load_state_dict({name: value for name, value in model.state_dict().items() if not name.startswith("image_encoder")})
    assert np.allclose(predicted(other, [blind], clouds)[0], one[1], atol=1e-5)
    assert len(without) == 1


@pytest.mark.parametrize("switch", ALL)
def test_every_weight_that_may_learn_gets_a_gradient_and_no_other(switch: str) -> None:
    config = dataclasses.replace(FULL, **ALL[switch])
    examples, clouds = toy(24, 7, points=64)
    objective = SelectionObjective(examples, [], clouds, config, BatchConfig(objects=6), 0)
    model = network(config, 0)
    torch.manual_seed(0)
    loss, parts = objective.loss(model, objective.batch(0))
    loss.backward()
    assert all(math.isfinite(value) for value in parts.values())
    without = {name for name, p in model.named_parameters() if p.requires_grad and (p.grad is None or not p.grad.abs().sum() > 0)}
    unused = set()
    if switch in ("nothing asked", "no temperature", "fixed"):
        unused |= {"logit_scale"} & without
    if switch == "nothing asked":  # what is compared has nothing to be compared with
        unused |= {"pc_projection", "size_embedding.weight", "size_embedding.bias"}
    assert without <= unused
    assert all(p.grad is None for p in model.parameters() if not p.requires_grad)


def test_frozen_weights_stay_and_the_last_block_learns() -> None:
    examples, clouds = toy(24, 8, points=64)
    config = dataclasses.replace(FULL, **SWITCHES["paper"])
    model = network(config, 0)
    freeze(model, "last")
    before = {name: value.clone() for name, value in model.state_dict().items()}
    objective = SelectionObjective(examples, [], clouds, config, BatchConfig(objects=4), 0)
    fitted = fit(model, objective, FittingConfig(steps=2, device="cpu"), seed=0, checkpoints={}, key="x", report=lambda *a: None)
    changed = {name for name, value in fitted.state_dict.items() if not torch.equal(value, before[name])}
    learned = {name for name in changed if "running" not in name and "tracked" not in name}
    assert learned == {
        name
        for name, p in model.named_parameters()
        if name.startswith(("quality.", "point_encoder.norm", "point_encoder.blocks.blocks.2."))
    }


def brute_force(scores: np.ndarray, ranking: list[int]) -> float:
    """Chance of the prefix: of all orders drawn one after another with odds exp(score), those that begin so."""
    odds = np.exp(scores[np.isfinite(scores)])
    names = np.flatnonzero(np.isfinite(scores))
    total = 0.0
    for order in itertools.permutations(range(len(names))):
        chance, left = 1.0, odds.sum()
        for i in order:
            chance *= odds[i] / left
            left -= odds[i]
        if [int(names[i]) for i in order[: len(ranking)]] == ranking:
            total += chance
    return total


def test_plackett_luce_is_the_chance_of_the_prefix() -> None:
    from tasks.selection.model.networks.losses import plackett_luce

    rng = np.random.default_rng(0)
    scores = rng.normal(size=(4, 5))
    scores[1, 3:] = -np.inf
    rankings = [[2, 0, 4], [1, 0], [3], []]
    padded = torch.tensor([row + [-1] * (4 - len(row)) for row in rankings])
    values = torch.tensor(scores, requires_grad=True)
    loss = plackett_luce(values, padded)
    expected = np.mean([-math.log(brute_force(scores[i], row)) / len(row) for i, row in enumerate(rankings) if row])
    assert loss.item() == pytest.approx(expected, rel=1e-9)
    loss.backward()
    assert torch.isfinite(values.grad).all()
    whole = plackett_luce(torch.tensor(scores[:1]), torch.tensor([[2, 0, 4, 1, 3]]))  # all are ranked: the last has no rival
    assert whole.item() == pytest.approx(-math.log(brute_force(scores[0], [2, 0, 4, 1, 3])) / 5, rel=1e-9)


def test_without_a_temperature_strangers_cannot_be_told_apart_as_specs_say() -> None:
    """L_aux cannot go below ln(1 + 9 exp(-4)) with two cosines (specs C.3, defect 1)."""
    from tasks.selection.model.networks.losses import total

    ideal = torch.tensor([[2.0] + [-2.0] * 9])
    batch = {"choice": torch.tensor([0]), "ranking": torch.tensor([[0]])}
    _, parts = total({"scores": ideal, "strangers": ideal}, batch, {"strangers": 1.0})
    assert parts["strangers"].item() == pytest.approx(math.log(1 + 9 * math.exp(-4)), abs=1e-6)


def test_the_same_seed_gives_the_same_weights_and_batches_that_follow_from_the_step() -> None:
    examples, clouds = toy(24, 9, points=64)
    config = BatchConfig(objects=4, regroup=True)
    objective = SelectionObjective(examples, examples[:4], clouds, FULL, config, 3)
    first, again = objective.batch(5), SelectionObjective(examples, [], clouds, FULL, config, 3).batch(5)
    assert first.keys() == again.keys()
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["clouds"], objective.batch(6)["clouds"])
    sent = pickle.loads(pickle.dumps(objective)).batch(5)  # as another process makes it
    assert all(torch.equal(first[name], sent[name]) for name in first)
    kept = []
    for _ in range(2):
        torch.rand(3)
        fitted = fit(
            network(FULL, 1),
            objective,
            FittingConfig(steps=3, validate_steps=2, device="cpu"),
            seed=1,
            checkpoints={},
            key="x",
            report=lambda *a: None,
        )
        kept.append(fitted.state_dict)
    assert all(torch.equal(kept[0][name], kept[1][name]) for name in kept[0])
    other = network(FULL, 2).state_dict()
    assert not torch.equal(network(FULL, 1).state_dict()["pc_projection"], other["pc_projection"])


def test_an_epoch_shows_every_example_once() -> None:
    shown = np.concatenate([chosen_objects(10, 4, step, 0) for step in range(5)])
    assert sorted(shown[:10]) == sorted(shown[10:]) == list(range(10))
    assert list(shown[:10]) != list(shown[10:])


def test_strangers_come_from_other_scenes() -> None:
    is_candidate = np.ones((3, 4), dtype=bool)
    is_candidate[2, 2:] = False
    others = others_of(is_candidate, ["a", "a", "b"], np.random.default_rng(0))
    assert sorted(others[0][others[0] >= 0]) == [8, 9]
    assert sorted(others[2][others[2] >= 0]) == list(range(8))
    assert (others_of(is_candidate, ["a"] * 3, np.random.default_rng(0)) == -1).all()


def test_a_batch_names_the_choice_after_mixing() -> None:
    examples, clouds = toy(12, 10, points=64)
    plain = AugmentationConfig(dropout=0.0, scale_least=1.0, scale_most=1.0, shift=0.0, tilt_radians=0.0, turn=False, crop=1.0)
    batch = training_batch(examples, clouds, FULL, BatchConfig(objects=6, augmentation=plain), 0, 0)
    chosen = [examples[i] for i in chosen_objects(12, 6, 0, 0)]
    for row, example in enumerate(chosen):
        features = features_of(example.scanned, example.contenders(clouds), FULL)
        assert np.allclose(batch["clouds"][row, batch["choice"][row]], features["clouds"][example.choice], atol=1e-5)
        assert np.allclose(batch["sizes"][row, batch["ranking"][row]], features["sizes"][list(example.rankings[0])])
        assert np.allclose(batch["scan"][row], features["scan"], atol=1e-5)


def test_rooms_are_on_one_side() -> None:
    examples, _ = toy(200, 11, points=16)
    learning, held = by_room(examples, 0.1)
    assert {e.room_id for e in learning}.isdisjoint({e.room_id for e in held})
    assert len({e.room_id for e in held}) == 2
    assert len(learning) + len(held) == 200
    assert by_room(list(reversed(examples)), 0.1)[1] == list(reversed(held))
    assert by_room(examples[:5], 0.1) == (examples[:5], [])


def test_points_far_apart_come_first_and_torch_agrees() -> None:
    from tasks.selection.model.clouds import farthest_order
    from tasks.selection.model.networks.blocks import farthest, seeded_starts

    points = np.random.default_rng(0).normal(size=(3, 40, 3)).astype(np.float32)
    starts = seeded_starts(3, 40, 7)
    assert torch.equal(starts, seeded_starts(3, 40, 7))
    order = farthest(torch.from_numpy(points), 12, starts).numpy()
    for cloud, row, start in zip(points, order, starts.tolist(), strict=True):
        assert farthest_order(cloud, 12, start).tolist() == row.tolist()
        kept = [start]
        while len(kept) < 12:  # by definition
            gaps = np.linalg.norm(cloud[:, None].astype(np.float64) - cloud[kept], axis=2).min(axis=1)
            kept.append(int(gaps.argmax()))
        assert row.tolist() == kept
    assert sorted(farthest_order(points[0], 40)) == list(range(40))
    same = np.zeros((5, 3))
    assert sorted(farthest_order(same, 5)) == list(range(5))


def test_nearest_both_is_the_nearest_both_ways() -> None:
    from tasks.selection.model.clouds import nearest_both

    rng = np.random.default_rng(1)
    scan, surfaces = rng.normal(size=(30, 3)).astype(np.float32), rng.normal(size=(4, 50, 3)).astype(np.float32)
    forth, back = nearest_both(scan, surfaces)
    apart = np.linalg.norm(scan[None, :, None] - surfaces[:, None], axis=3)
    assert np.array_equal(forth, apart.argmin(axis=2))
    assert np.array_equal(back, apart.argmin(axis=1))


@pytest.mark.slow
@pytest.mark.whole
def test_the_toy_problem_is_learned_in_a_few_steps() -> None:
    """Specs C.8: chance is 10 %; the bound of CI there is 30 %."""
    examples, clouds = toy(240, 0, points=96)
    tests, more = toy(60, 1, points=96)
    config = dataclasses.replace(FULL, residual_points=48, text=OwnText(buckets=64, width=8))
    objective = SelectionObjective(examples, [], clouds, config, BatchConfig(objects=8), 0)
    settings = FittingConfig(steps=80, learning_rate=4e-3, warmup_steps=10, device="cpu")
    fitted = fit(network(config, 0), objective, settings, seed=0, checkpoints={}, key="x", report=lambda *a: None)
    model = network(config, 0)
    model.load_state_dict(dict(fitted.state_dict))
    scores = predicted(model, tests, more)
    top = np.mean([row.argmax() == example.choice for row, example in zip(scores, tests, strict=True)])
    assert top > 0.6
