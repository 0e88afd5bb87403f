"""Fitting goes on to the same bytes after any interruption, with any number of loading processes, and keeps the best weights."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import math
from collections.abc import MutableMapping
from typing import Any

import numpy as np
import pytest

from tasks.training.checkpoints import names_of
from tasks.training.fitting import FittingConfig, decay_at, fit, forget, learning_rate_at, seeded, weights_of
from tasks.training.trained import Diverged
from tasks.weights import from_safetensors

torch = pytest.importorskip("torch")

QUICK = FittingConfig(steps=23, warmup_steps=3, checkpoint_steps=4, validate_steps=6, record_steps=5)


AVERAGED = dataclasses.replace(QUICK, averaging=0.8, learning_rate=0.05)


class Interrupted(Exception):
    pass


class Product:
    """The product of two numbers of eight, learned from draws."""

    def __init__(self) -> None:
        self.validations: list[float] = []

    def batch(self, step: int) -> Any:
        inputs = torch.from_numpy(np.random.default_rng([5, step]).normal(size=(8, 8)).astype(np.float32))
        return inputs + 0.01 * torch.randn(8, 8)

    def loss(self, module: Any, batch: Any) -> Any:
        loss = (module(batch)[:, 0] - batch[:, 0] * batch[:, 1]).square().mean()
        return loss, {"square": float(loss.detach())}

    def validate(self, module: Any) -> float:
        inputs = torch.from_numpy(np.random.default_rng(1).normal(size=(64, 8)).astype(np.float32))
        self.validations.append(-float((module(inputs).detach()[:, 0] - inputs[:, 0] * inputs[:, 1]).square().mean()))
        return self.validations[-1]


def network() -> Any:
    with seeded(3, "network"):
        layers = [torch.nn.Linear(8, 16), torch.nn.ReLU(), torch.nn.BatchNorm1d(16), torch.nn.Dropout(0.2), torch.nn.Linear(16, 1)]
        return torch.nn.Sequential(*layers)


def fitted(
    config: FittingConfig = QUICK, kept: MutableMapping[str, bytes] | None = None, stop: int = 0, seed: int = 0, **given: Any
) -> Any:
    def report(done: int, of: int, text: str) -> None:
        assert of == config.steps
        if done == stop:
            raise Interrupted

    objective, module = given.get("objective", Product()), given.get("module", network())
    return fit(module, objective, config, seed=seed, checkpoints={} if kept is None else kept, key="training", report=report)


def digest(result: Any) -> str:
    curve = [(point.step, point.loss, point.parts, point.learning_rate, point.validation) for point in result.steps]
    return hashlib.sha256(weights_of(result.state_dict) + repr((curve, result.best_step, result.validation)).encode()).hexdigest()


@pytest.fixture(scope="module")
def whole() -> str:
    return digest(fitted())


def test_it_is_the_same_twice_and_another_with_another_seed(whole: str) -> None:
    torch.rand(7)  # what others draw has no part in it
    assert digest(fitted()) == whole
    assert digest(fitted(seed=1)) != whole


@pytest.mark.parametrize("stops", [(1,), (4,), (9, 10), (3, 22, 23), (23,)])
def test_after_interruptions_it_goes_on_to_the_same_weights(whole: str, stops: tuple[int, ...]) -> None:
    kept: dict[str, bytes] = {}
    for stop in stops:
        with pytest.raises(Interrupted):
            fitted(kept=kept, stop=stop)
        assert len(kept) <= 2
    assert digest(fitted(kept=kept)) == whole


def test_what_interrupts_in_the_middle_of_a_write_costs_the_steps_since_the_checkpoint_before(whole: str) -> None:
    kept: dict[str, bytes] = {}
    with pytest.raises(Interrupted):
        fitted(kept=kept, stop=18)
    newest, before = names_of(kept, "training")
    for damage in (b"", kept[newest][:-100], kept[newest][:50] + b"x" * 50 + kept[newest][100:], b"\x80\x04cos\nsystem\n(S'true'\ntR."):
        damaged = kept | {newest: damage}
        assert digest(fitted(kept=damaged)) == whole
    assert digest(fitted(kept={newest: b"", before: b""})) == whole


def test_checkpoints_of_other_settings_do_not_count_and_idle_ones_do_not_matter(whole: str) -> None:
    kept: dict[str, bytes] = {}
    with pytest.raises(Interrupted):
        fitted(dataclasses.replace(QUICK, weight_decay=0.3), kept, stop=12)
    assert digest(fitted(kept=dict(kept))) == whole
    assert digest(fitted(dataclasses.replace(QUICK, checkpoint_steps=1))) == whole
    forget(kept, "train")
    assert kept
    forget(kept, "training")
    assert not kept


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize("workers", [1, 2])
def test_whoever_loads_the_batches_the_weights_are_the_same(whole: str, workers: int) -> None:
    config = dataclasses.replace(QUICK, workers=workers)
    kept: dict[str, bytes] = {}
    with pytest.raises(Interrupted):
        fitted(config, kept, stop=11)
    assert digest(fitted(config, kept)) == whole


def test_the_best_weights_are_kept() -> None:
    objective = Product()
    result = fitted(dataclasses.replace(QUICK, learning_rate=0.5, weight_decay=0.0, validate_steps=1), objective=objective)
    assert result.validation == max(objective.validations)
    assert result.best_step == objective.validations.index(result.validation) + 1
    module = network()
    module.load_state_dict(result.state_dict)
    assert objective.validate(module.eval()) == result.validation


@pytest.mark.parametrize("stops", [(1,), (6, 9), (3, 22, 23)])
def test_the_mean_of_weights_goes_on_after_interruptions(stops: tuple[int, ...]) -> None:
    kept: dict[str, bytes] = {}
    for stop in stops:
        with pytest.raises(Interrupted):
            fitted(AVERAGED, kept, stop=stop)
    assert digest(fitted(AVERAGED, kept)) == digest(fitted(AVERAGED))


def test_the_mean_is_that_of_the_recursion_and_is_what_is_validated_and_kept() -> None:
    class Watched(Product):
        def __init__(self) -> None:
            super().__init__()
            self.seen: list[dict[str, Any]] = []

        def loss(self, module: Any, batch: Any) -> Any:
            self.seen.append({name: tensor.detach().clone() for name, tensor in module.state_dict().items()})
            return super().loss(module, batch)

    objective, module = Watched(), network()
    config = dataclasses.replace(AVERAGED, validate_steps=1)
    result = fitted(config, objective=objective, module=module)
    last = module.state_dict()
    # a step sees the weights, before it, but running figures of norms after the steps before alone
    weights = [*objective.seen[1:], last]
    expected, scores = objective.seen[0], []
    plain = fitted(dataclasses.replace(config, averaging=0.0), module=network())
    for step, state in enumerate(weights):
        decay = decay_at(step, 0.8)
        expected = {
            name: decay * mean + (1 - decay) * state[name] if mean.is_floating_point() else state[name] for name, mean in expected.items()
        }
        other = network()
        other.load_state_dict(expected)
        scores.append(Product().validate(other.eval()))
    assert objective.validations == pytest.approx(scores, rel=1e-4)
    assert plain.validation != pytest.approx(result.validation)
    mean = fitted(dataclasses.replace(AVERAGED, validate_steps=23))
    for name, tensor in mean.state_dict.items():
        torch.testing.assert_close(tensor, expected[name])
    assert decay_at(0, 0.8) == 0.1
    assert decay_at(10**6, 0.8) == 0.8
    for name, tensor in last.items():
        if tensor.is_floating_point():
            assert not torch.equal(tensor, expected[name])


def test_what_needs_no_gradient_stays_as_it_was_and_is_in_no_checkpoint() -> None:
    module = network()
    before = module[0].weight.detach().clone()
    module[0].weight.requires_grad_(False)
    kept: dict[str, bytes] = {}
    result = fitted(kept=kept, module=module)
    assert torch.equal(result.state_dict["0.weight"], before)
    assert all(b"0.weight" not in data for data in kept.values())
    assert not torch.equal(result.state_dict["0.bias"], network()[0].bias)


def test_curves_are_means_and_say_when_somebody_looked() -> None:
    every = fitted(dataclasses.replace(QUICK, record_steps=1)).steps
    points = fitted().steps
    assert [point.step for point in points] == [5, 10, 15, 20, 23]
    for (first, last), point in zip(itertools.pairwise([0, *(point.step for point in points)]), points, strict=True):
        assert point.loss == pytest.approx(math.fsum(one.loss for one in every[first:last]) / (last - first), rel=1e-12)
        assert point.parts == {"square": pytest.approx(point.loss)}
    assert [point.step for point in points if point.validation is not None] == [10, 15, 20, 23]


def test_a_loss_that_is_no_number_ends_it() -> None:
    class Broken(Product):
        def loss(self, module: Any, batch: Any) -> Any:
            return module(batch).sum() * math.inf, {}

    with pytest.raises(Diverged, match="in step 0; lower learning_rate"):
        fitted(objective=Broken())


def test_torch_is_left_as_it_was() -> None:
    before = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled(), torch.get_rng_state()
    fitted(dataclasses.replace(QUICK, threads=1))
    assert (torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()) == before[:2]
    assert torch.equal(torch.get_rng_state(), before[2])


def test_the_step_size_rises_to_the_peak_and_falls_to_the_end() -> None:
    config = FittingConfig(steps=100, warmup_steps=10, learning_rate=0.1, final_learning_rate=0.001)
    rates = [learning_rate_at(step, config) for step in range(100)]
    assert rates.index(max(rates)) == 9
    assert max(rates) == config.learning_rate
    assert rates[-1] == pytest.approx(config.final_learning_rate)
    assert all(one < two for one, two in itertools.pairwise(rates[:10]))
    assert all(one > two for one, two in itertools.pairwise(rates[9:]))
    assert learning_rate_at(0, FittingConfig(steps=1, warmup_steps=0)) > 0


def test_weights_are_written_in_half_precision_where_that_is_asked() -> None:
    state = network().state_dict()
    whole_, half = from_safetensors(weights_of(state)), from_safetensors(weights_of(state, half=True))
    for name, tensor in state.items():
        assert np.array_equal(whole_[name], tensor.numpy())
        assert half[name].dtype == (np.float16 if tensor.is_floating_point() else tensor.numpy().dtype)
        np.testing.assert_allclose(half[name], tensor.numpy(), rtol=1e-3, atol=1e-4)
