"""What synthesis models learn from: batches, losses, and layouts that are drawn by what was learned."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest

from tasks.synthesis.layout import Large, Layout
from tasks.synthesis.model.config import DiffuScene, Noise
from tasks.synthesis.model.encoding import BOX, encoding_of
from tasks.synthesis.model.objective import SynthesisObjective, atiss_batch, diffusion_batch, examples_of
from tests.tasks.synthesis.drawn_layouts import layouts
from tests.tasks.synthesis.test_networks import ATISS, MODELS, PLAIN, network

torch = pytest.importorskip("torch")

LEARNED = layouts(60, most=8)
ENCODING = encoding_of(LEARNED)
EXAMPLES = examples_of(LEARNED, ENCODING, 6)


def objective(model, held=()):
    return SynthesisObjective(EXAMPLES, examples_of(held, ENCODING, 6), ENCODING, model, 16, 3)


def rows(vectors) -> list[bytes]:
    return sorted(row.tobytes() for row in vectors)


def test_all_objects_are_kept_whatever_a_model_has_room_for() -> None:
    assert EXAMPLES.vectors.shape[1] == max(len(layout) for layout in LEARNED) + 1 > 6
    for layout, vectors, count in zip(LEARNED, EXAMPLES.vectors, EXAMPLES.counts, strict=True):
        assert count == len(layout)
        assert rows(vectors[1 : count + 1]) == rows(ENCODING.vectors(layout, count + 1)[1:])


@pytest.mark.parametrize("name", sorted(MODELS))
def test_a_batch_is_that_of_its_step_and_an_objective_can_be_sent(name: str) -> None:
    own = objective(MODELS[name])
    batch = own.batch(4)
    np.random.seed(1)
    again = pickle.loads(pickle.dumps(own)).batch(4)
    assert all(torch.equal(batch[key], again[key]) for key in batch)
    assert not torch.equal(batch["large"], own.batch(5)["large"])


def test_a_denoiser_learns_from_whole_layouts_in_any_order_behind_the_large_object() -> None:
    model = MODELS["transformer"]
    chosen = np.repeat(np.arange(60), 50)
    batch = diffusion_batch(EXAMPLES, chosen, model, ENCODING.rooms, np.random.default_rng(0), hides=True)
    np.testing.assert_array_equal(batch["clean"][:, 0], EXAMPLES.vectors[chosen, 0])
    filled = batch["clean"][..., BOX:].argmax(axis=-1)[:, 1:] != ENCODING.empty
    np.testing.assert_array_equal(filled.sum(axis=1), np.minimum(EXAMPLES.counts[chosen], 5))
    ones = EXAMPLES.counts[chosen] == 1
    assert 0.12 < filled[ones].mean(axis=0).min() <= filled[ones].mean(axis=0).max() < 0.28
    for place in range(0, 3000, 50):
        if EXAMPLES.counts[chosen[place]] <= 5:
            assert rows(batch["clean"][place]) == rows(EXAMPLES.vectors[chosen[place], :6])
    assert 0.07 < (batch["room"] != EXAMPLES.room[chosen]).mean() < 0.13
    assert set(batch["room"][batch["room"] != EXAMPLES.room[chosen]]) == {0}
    assert 0.07 < batch["is_null"].mean() < 0.13
    assert (batch["steps"].min(), batch["steps"].max()) == (0, 199)
    plain = diffusion_batch(EXAMPLES, chosen, model, ENCODING.rooms, np.random.default_rng(0), hides=False)
    assert not plain["is_null"].any()
    np.testing.assert_array_equal(plain["room"], EXAMPLES.room[chosen])


def test_atiss_learns_from_every_beginning_and_what_comes_next() -> None:
    batch = atiss_batch(EXAMPLES, np.repeat(np.arange(60), 200), ATISS, ENCODING.rooms, np.random.default_rng(0), hides=False)
    known = batch["is_there"].sum(axis=1) - 1
    counts = np.repeat(np.minimum(EXAMPLES.counts, 5), 200)
    assert batch["is_there"][:, 0].all()
    np.testing.assert_array_equal(batch["is_end"], known == counts)
    np.testing.assert_array_equal(batch["next_class"] == len(ENCODING.classes) + 1, batch["is_end"])
    for count in range(1, 6):
        shares = np.bincount(known[counts == count], minlength=count + 1) / (counts == count).sum()
        np.testing.assert_allclose(shares, 1 / (count + 1), atol=0.05)
    for place in range(0, 12_000, 97):
        if not batch["is_end"][place]:
            following = EXAMPLES.vectors[place // 200][:, :6]
            assert batch["next_box"][place, :6].tobytes() in {row.tobytes() for row in following[1:]}
            before = {row.tobytes() for row in batch["boxes"][place, 1 : known[place] + 1, :6]}
            assert batch["next_box"][place, :6].tobytes() not in before


@pytest.mark.parametrize("prefixes", ["even", "published"])
def test_how_often_sets_end_is_told_by_even_beginnings_alone(prefixes: str) -> None:
    own = objective(dataclasses.replace(ATISS, prefixes=prefixes))
    own = dataclasses.replace(own, scenes=20_000)
    batch = own.batch(0)
    known = (batch["is_there"].sum(dim=1) - 1).numpy()
    ends = batch["is_end"].numpy()
    counts = np.minimum(EXAMPLES.counts, 5)
    sizes = range(1, 5)
    truth = np.array([(counts == size).sum() / (counts >= size).sum() for size in sizes])
    shares = np.array([ends[known == size].mean() for size in sizes])
    if prefixes == "even":
        np.testing.assert_allclose(shares, truth, atol=0.03)
    else:
        assert (shares - truth).mean() > 0.02


@pytest.mark.parametrize("name", ["transformer", "unet"])
@pytest.mark.parametrize("target", ["v", "eps"])
def test_a_denoiser_that_knows_the_answer_has_no_loss_but_overlaps(name: str, target: str) -> None:
    model = dataclasses.replace(MODELS[name], noise=Noise(target=target), iou_weight=0.5)
    own = objective(model)
    batch = own.batch(0)
    left = torch.cumprod(1 - torch.linspace(1e-5**0.5, 0.1**0.5, 200) ** 2, 0)[batch["steps"]][:, None, None]
    answer = batch["noise"] if target == "eps" else left.sqrt() * batch["noise"] - (1 - left).sqrt() * batch["clean"]
    seen = []

    def knows(noised, steps, *given):
        seen.append(noised)
        return torch.cat([torch.full_like(answer[:, :1], 99.0), answer[:, 1:]], dim=1)  # of the large object nothing counts

    loss, parts = own.loss(knows, batch)
    assert parts["box"] < 1e-9
    assert parts["class"] < 1e-3
    assert parts["overlap"] > 0
    assert float(loss) == pytest.approx(0.5 * parts["overlap"], abs=1e-3)
    torch.testing.assert_close(seen[0][:, 0], batch["clean"][:, 0])
    torch.testing.assert_close(seen[0][:, 1:], (left.sqrt() * batch["clean"] + (1 - left).sqrt() * batch["noise"])[:, 1:])
    weighted = dataclasses.replace(
        own, model=dataclasses.replace(model, iou_weight=0.0, categories="numbers", noise=Noise(weighting="snr"))
    )
    blank = lambda noised, *given: torch.zeros_like(noised)  # noqa: E731
    velocity = (left.sqrt() * batch["noise"] - (1 - left).sqrt() * batch["clean"])[:, 1:].square() * left
    expected = velocity[..., :BOX].mean() + velocity[..., BOX:].mean()
    assert float(weighted.loss(blank, batch)[0]) == pytest.approx(float(expected), rel=1e-4)


def test_overlaps_are_those_of_boxes_and_no_object_overlaps_itself() -> None:
    from tasks.synthesis.model.objective import overlaps

    large = Large("desk", (0.7, 1.4, 0.75), "office")
    boxes = [((0, 0, 1), (1, 1, 1)), ((0.5, 0, 1), (1, 1, 1)), ((3, 3, 1), (1, 2, 1))]
    centers, sizes = map(np.array, zip(*boxes, strict=True))
    layout = Layout(large, ("mug",) * 3, centers, sizes, np.zeros(3))
    encoding = encoding_of([layout, LEARNED[0]])
    vectors = torch.from_numpy(encoding.vectors(layout, 6))[None, 1:]
    is_object = torch.arange(5)[None] < 3
    assert float(overlaps(vectors[..., :6], is_object, encoding)) == pytest.approx((1 / 3) / 3, rel=1e-4)
    assert float(overlaps(vectors[..., :6], torch.arange(5)[None] < 1, encoding)) == 0.0


def test_of_the_end_nothing_but_its_category_counts() -> None:
    own, module = objective(ATISS), network(ATISS, ENCODING)
    batch = own.batch(0)
    batch["is_end"] = torch.ones(16, dtype=torch.bool)
    loss, parts = own.loss(module, batch)
    assert (parts["translation"], parts["angle"], parts["size"]) == (0, 0, 0)
    assert float(loss.detach()) == pytest.approx(parts["class"])


def one_kind(count: int) -> list[Layout]:
    """Desks of one size with a monitor at the back and, on every other one, a mug at the front, all somewhat displaced."""
    large, rng = Large("desk", (0.7, 1.4, 0.75), "office"), np.random.default_rng(0)
    made = []
    for number in range(count):
        kept = slice(0, 1 + number % 2)
        places = np.array([[-0.2, 0.0, 1.0], [0.2, 0.4, 0.8]]) + rng.normal(0.0, 0.03, (2, 3))
        sizes = np.array([[0.2, 0.5, 0.4], [0.1, 0.1, 0.1]]) * rng.uniform(0.8, 1.2, (2, 3))
        made.append(Layout(large, ("monitor", "mug")[kept], places[kept], sizes[kept], np.array([0.0, 1.0])[kept]))
    return made


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize("name", ["transformer", pytest.param("unet alike", marks=pytest.mark.slow), "atiss"])
def test_what_is_drawn_is_as_what_was_learned(name: str) -> None:
    from tasks.synthesis.model.sampling import drawn
    from tasks.training.fitting import FittingConfig, fit

    learned = one_kind(40)
    encoding = encoding_of(learned)
    model = dataclasses.replace(MODELS[name], slots=4)
    if isinstance(model, DiffuScene) or name == "transformer":
        model = dataclasses.replace(model, noise=Noise(steps=25, beta_low=4e-3, beta_high=0.49, curve="linear"), categories="chances")
    if name == "transformer":
        model = dataclasses.replace(model, architecture=dataclasses.replace(PLAIN, width=32))
    own = SynthesisObjective(examples_of(learned, encoding, 4), examples_of(learned[:8], encoding, 4), encoding, model, 32, 0)
    module = network(model, encoding)
    config = FittingConfig(steps=800, learning_rate=4e-3, averaging=0.98, validate_steps=800, device="cpu")
    fitted = fit(module, own, config, seed=0, checkpoints={}, key="k", report=lambda *_: None)
    module.load_state_dict(fitted.state_dict)
    assert fitted.steps[-1].loss < 0.7 * fitted.steps[0].loss
    made = drawn(module, encoding, [learned[0].large] * 100, 0)
    again = drawn(module, encoding, [learned[0].large] * 100, 0)
    assert [layout.categories for layout in made] == [layout.categories for layout in again]
    monitors = [layout.categories.count("monitor") for layout in made]
    mugs = [layout.categories.count("mug") for layout in made]
    assert np.mean(np.array(monitors) == 1) > 0.85
    assert 0.25 < np.mean(mugs) < 0.75
    for category, expected in (("monitor", (-0.2, 0.0, 1.0)), ("mug", (0.2, 0.4, 0.8))):
        places = [center for layout in made for name_, center in zip(layout.categories, layout.centers, strict=True) if name_ == category]
        np.testing.assert_allclose(np.median(places, axis=0), expected, atol=0.12)
    if name != "atiss":
        fast = drawn(module, encoding, [learned[0].large] * 100, 0, steps=5)
        assert 0.7 < np.mean([layout.categories.count("monitor") for layout in fast]) < 1.3


def test_guidance_of_one_is_the_text_and_of_none_is_without_it() -> None:
    from tasks.synthesis.model.sampling import predicted

    sample, places = torch.randn(2, 6, ENCODING.width), torch.tensor([[0, 1], [1, 2]])
    made = {}
    for weight in (0.0, 1.0, 3.0):
        module = network(dataclasses.replace(MODELS["transformer"], guidance=weight), ENCODING)
        with torch.no_grad():
            made[weight] = predicted(module, sample, 9, places)
            null = module(sample, torch.tensor([9, 9]), places[:, 0], places[:, 1], torch.tensor([True, True]))
    torch.testing.assert_close(made[0.0], null)
    torch.testing.assert_close(made[3.0], null + 3 * (made[1.0] - null), rtol=1e-4, atol=1e-5)
    assert not torch.allclose(made[1.0], null, atol=1e-4)
