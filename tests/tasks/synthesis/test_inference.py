"""Layouts drawn without torch, held against torch with random weights."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.synthesis.inference.atiss import CHANCES, chosen, logistic
from tasks.synthesis.inference.drawer import load
from tasks.synthesis.inference.guidance import Guidance
from tasks.synthesis.layout import Large
from tasks.synthesis.metrics.boxes import box_figures
from tasks.synthesis.model.config import Atiss, ClipText, DiffuScene, LearnedText, Noise, PhyScene, Transformer, Unet
from tasks.synthesis.model.encoding import encoding_of
from tasks.synthesis.model.shapes import shapes_of
from tasks.weights import to_safetensors
from tests.conftest import REPOSITORY
from tests.tasks.synthesis.drawn_layouts import layouts

TEXT = LearnedText(width=8)
UNET = Unet(width=16, levels=2, groups=4, heads=2, head_width=8, instance_width=4, crosses=True)
PLAIN = Transformer(width=20, layers=2, heads=2, feedforward=24)
BRIEF = Noise(steps=12, beta_low=0.01, beta_high=0.4)
ATISS = Atiss(slots=6, text=TEXT, embedding=4, layers=2, heads=2, feedforward=24, mixtures=3)
MODELS = {
    "unet": DiffuScene(slots=6, text=TEXT, architecture=UNET, noise=BRIEF, categories="numbers"),
    "unet alike": DiffuScene(
        slots=5, text=TEXT, architecture=dataclasses.replace(UNET, instance_width=0, crosses=False), noise=BRIEF, guidance=2.5
    ),
    "transformer": PhyScene(slots=6, text=TEXT, architecture=PLAIN, noise=dataclasses.replace(BRIEF, target="eps"), guidance=1.5),
    "numbers": PhyScene(slots=6, text=TEXT, architecture=PLAIN, noise=dataclasses.replace(BRIEF, target="eps"), categories="numbers"),
    "clip": PhyScene(slots=6, text=ClipText(width=12), architecture=PLAIN, noise=BRIEF),
    "waves": PhyScene(slots=6, text=TEXT, architecture=dataclasses.replace(PLAIN, waves=4), noise=BRIEF),
    "scaled": DiffuScene(slots=6, text=TEXT, architecture=PLAIN, noise=dataclasses.replace(BRIEF, curve="scaled_linear")),
    "atiss": ATISS,
    "default transformer": DiffuScene(),
    "default unet": DiffuScene(architecture=Unet()),
    "default atiss": Atiss(),
}
DENOISERS = [name for name in MODELS if "atiss" not in name]
ENCODING = encoding_of(layouts(30))
LARGES = [layout.large for layout in layouts(40, seed=1)]
UNGUIDED = Guidance(share=0.0, settling=0, tries=1)


def trained(model, seed=0):
    """A network with random weights, also where training begins with zeros and ones, and what draws by the same at half precision."""
    torch = pytest.importorskip("torch")
    from tasks.training.systems.synthesis import network

    module = network(model, ENCODING, seed).eval()
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for values in module.state_dict().values():
            values += 0.05 * torch.randn(values.shape, generator=generator)
            values.copy_(values.half())
    state = {name: values.numpy().astype("<f2") for name, values in module.state_dict().items()}
    return module, load(to_safetensors(state | ENCODING.arrays()), model)


def random(model, seed=0):
    """What draws by random weights, without torch."""
    rng = np.random.default_rng(seed)
    arrays = {name: rng.normal(0.0, 0.2, shape).astype("<f2") for name, shape in shapes_of(model, ENCODING).items()}
    return load(to_safetensors(arrays | ENCODING.arrays()), model)


def same(one, other):
    return one.categories == other.categories and all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in ("centers", "sizes", "yaws")
    )


def assert_near(made, wanted, limit=1e-4):
    assert [layout.categories for layout in made] == [layout.categories for layout in wanted]
    for one, other in zip(made, wanted, strict=True):
        np.testing.assert_allclose(one.centers, other.centers, atol=limit)
        np.testing.assert_allclose(one.sizes, other.sizes, atol=limit)
        np.testing.assert_allclose(np.exp(1j * one.yaws), np.exp(1j * other.yaws), atol=10 * limit)


def known(larges):
    torch = pytest.importorskip("torch")
    places = np.array([ENCODING.condition(large) for large in larges])
    return places, (torch.from_numpy(places[:, 0]), torch.from_numpy(places[:, 1]))


@pytest.mark.parametrize("name", DENOISERS)
def test_a_denoiser_tells_what_it_tells_in_torch(name: str) -> None:
    torch = pytest.importorskip("torch")
    model = MODELS[name]
    module, drawer = trained(model)
    noised = np.random.default_rng(0).normal(size=(16, model.slots, ENCODING.width)).astype(np.float32)
    places, given = known(LARGES[:16])
    for step in (0, 7, model.noise.steps - 1):
        for is_null in (False, True):
            with torch.no_grad():
                wanted = module(torch.from_numpy(noised), torch.full((16,), step), *given, torch.full((16,), is_null))
            made = drawer.network.prediction(noised, step, drawer.network.conditions(noised[:, 0], places, is_null=is_null))
            np.testing.assert_allclose(made[:, 1:], wanted[:, 1:], rtol=1e-5, atol=2e-5)  # targets of one-hots reach 8, in single precision


@pytest.mark.parametrize("name", ["atiss", "default atiss"])
def test_atiss_tells_what_it_tells_in_torch(name: str) -> None:
    torch = pytest.importorskip("torch")
    module, drawer = trained(MODELS[name])
    network, rng, (places, given) = drawer.network, np.random.default_rng(0), known(LARGES[:16])
    classes, boxes = rng.integers(len(ENCODING.classes), size=(16, 5)), rng.uniform(-1, 1, (16, 5, 7)).astype(np.float32)
    told = [torch.from_numpy(part) for part in (classes[:, :4], boxes[:, :4], np.ones((16, 4), dtype=bool))]
    with torch.no_grad():
        wanted = module(*told, *given, torch.from_numpy(classes[:, 4]), torch.from_numpy(boxes[:, 4]))
    tokens = [network.token(classes[:, slot], boxes[:, slot], is_large=slot == 0) for slot in range(4)]
    after = network.next(np.concatenate([network.start(places), *tokens], axis=1))
    np.testing.assert_allclose(after.logits, wanted["class"], atol=1e-5)
    before = boxes[:, 4][:, [0, 1, 2, 6]]
    for part, count in (("translation", 0), ("angle", 3), ("size", 4)):
        np.testing.assert_allclose(network.mixtures(after.hidden, classes[:, 4], before[:, :count], part), wanted[part], atol=1e-5)


def drawn_by_torch(module, larges, steps=None, seed=3):
    """Layouts by `sampling`, whose random numbers are those that a drawer takes."""
    import torch

    from tasks.synthesis.model.sampling import drawn

    rngs = [np.random.default_rng([seed, number]) for number in range(len(larges))]
    shape = (module.config.slots, ENCODING.width)

    def normal(size, **_):
        assert tuple(size) == (len(larges), *shape)
        return torch.from_numpy(np.array([rng.standard_normal(shape, dtype=np.float32) for rng in rngs]))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torch, "randn", normal)
        return drawn(module, ENCODING, larges, 0, steps)


@pytest.mark.parametrize(
    ("name", "steps"), [*((name, None) for name in DENOISERS if "default" not in name), ("unet alike", 5), ("transformer", 12)]
)
def test_diffused_layouts_are_those_of_torch_and_diffusers(name: str, steps: int | None) -> None:
    pytest.importorskip("diffusers")
    module, drawer = trained(MODELS[name])
    made = drawer.draw(LARGES[:9], 3, steps=steps, guidance=UNGUIDED)
    assert sum(map(len, made)) > 0
    assert_near(made, drawn_by_torch(module, LARGES[:9], steps))


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize("name", ["default transformer", "default unet"])
def test_layouts_of_default_models_are_those_of_torch_and_diffusers(name: str) -> None:
    pytest.importorskip("diffusers")
    module, drawer = trained(MODELS[name])
    made = drawer.draw(LARGES[:16], 3)
    assert sum(map(len, made)) > 0
    assert_near(made, drawn_by_torch(module, LARGES[:16]))


@pytest.mark.parametrize("name", ["atiss", "default atiss"])
def test_layouts_drawn_one_object_after_another_are_those_of_torch(name: str) -> None:
    torch = pytest.importorskip("torch")
    from tasks.synthesis.model.sampling import drawn

    module, drawer = trained(MODELS[name])
    larges, queue = LARGES[:12], []
    rngs = [np.random.default_rng([3, number]) for number in range(len(larges))]

    def even():
        """Numbers of the next call: of the category, then by part of the logistics and of the values."""
        if not queue:
            row = torch.from_numpy(np.array([rng.random(CHANCES, dtype=np.float32) for rng in rngs]))
            queue.extend([row[:, 0], row[:, 1:7:2], row[:, 2:7:2], row[:, 7:8], row[:, 8:9], row[:, 9::2], row[:, 10::2]])
        return queue.pop(0)

    def multinomial(shares, _, **__):
        sums = shares.double().cumsum(dim=-1)
        return (sums <= even().reshape(-1, 1) * sums[:, -1:]).sum(dim=-1, keepdim=True)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(torch, "multinomial", multinomial)
        patch.setattr(torch, "rand", lambda shape, **_: even().reshape(shape))
        wanted = drawn(module, ENCODING, larges, 0)
    made = drawer.draw(larges, 3)
    assert len({len(layout) for layout in made}) > 1
    assert_near(made, wanted, 1e-3)  # each number is told as waves of up to ten turns to those after it


@pytest.mark.parametrize("name", ["unet", "transformer", "atiss", "default transformer"])
def test_a_layout_is_the_same_to_the_last_bit_whatever_is_drawn_with_it(name: str) -> None:
    drawer, steps = random(MODELS[name]), 6 if name.startswith("default") else None
    together = drawer.draw(LARGES, 7, steps=steps, guidance=Guidance(share=0.5))
    assert sum(map(len, together)) > len(LARGES)
    numbers = [37, 5, 21, 0, 38, 6]
    some = drawer.draw([LARGES[number] for number in numbers], 7, numbers, steps=steps, guidance=Guidance(share=0.5))
    alone = drawer.draw([LARGES[21]], 7, [21], steps=steps, guidance=Guidance(share=0.5))[0]
    assert all(same(made, together[number]) for made, number in zip(some, numbers, strict=True))
    assert same(alone, together[21])
    assert not same(drawer.draw([LARGES[21]], 8, [21], steps=steps)[0], together[21])
    assert not same(drawer.draw([LARGES[21]], 7, [20], steps=steps)[0], together[21])
    assert drawer.draw([], 7) == []


def test_guided_layouts_collide_and_float_less_and_physcene_is_guided_by_itself() -> None:
    drawer = random(MODELS["clip"])
    plain, guided = drawer.draw(LARGES, 0, guidance=UNGUIDED), drawer.draw(LARGES, 0)
    assert box_figures(plain).off_support > 0.5
    assert box_figures(guided).off_support < 0.1 * box_figures(plain).off_support
    assert box_figures(guided).collides <= box_figures(plain).collides
    likes = random(MODELS["unet"]), random(PhyScene(**vars(MODELS["unet"])))
    assert all(map(same, likes[0].draw(LARGES[:3], 0), likes[1].draw(LARGES[:3], 0, guidance=UNGUIDED)))


@pytest.mark.parametrize("name", ["unet", "atiss"])
def test_drawn_layouts_stay_within_what_was_learned(name: str) -> None:
    for layout in random(MODELS[name]).draw(LARGES, 1):
        assert len(layout) < MODELS[name].slots
        assert {*layout.categories} <= {*ENCODING.small}
        low, high = ENCODING.low - 1e-9, ENCODING.high + 1e-9
        numbers = np.column_stack([layout.centers, 0.5 * layout.sizes])
        assert ((low <= numbers) & (numbers <= high)).all()


@settings(max_examples=30)
@given(st.lists(st.floats(0, 1, width=32), min_size=1, max_size=6).filter(any), st.floats(0, 1, width=32))
def test_places_are_chosen_in_proportion_and_never_without_a_share(shares: list[float], chance: float) -> None:
    values = np.array([shares], dtype=np.float32)
    place = int(chosen(values, np.array([chance], dtype=np.float32))[0])
    assert values[0, place] > 0
    sums = np.cumsum(values[0].astype(np.float64))
    assert sums[place] >= chance * sums[-1] - 1e-9
    assert place == 0 or sums[place - 1] <= chance * sums[-1]


def test_numbers_drawn_from_mixtures_have_their_shares() -> None:
    rng = np.random.default_rng(0)
    weights, middles, scales = np.log([0.2, 0.5, 0.3]), np.array([-0.6, 0.0, 0.5]), np.log([0.02, 0.05, 0.01])
    values = np.tile(np.concatenate([weights, middles, scales]).astype(np.float32), (20_000, 1))
    drawn = np.sort(logistic(values, rng.random((20_000, 2)).astype(np.float32)))
    at = np.linspace(-0.9, 0.9, 61)
    wanted = (np.array([0.2, 0.5, 0.3]) / (1.0 + np.exp(-(at[:, None] - middles) / np.exp(scales)))).sum(axis=1)
    np.testing.assert_allclose(np.searchsorted(drawn, at) / len(drawn), wanted, atol=0.012)


def test_what_a_model_does_not_know_is_refused() -> None:
    drawer, (depth, width, height) = random(ATISS), LARGES[0].size
    with pytest.raises(InputError, match=r"'sofa' is no large object that the model knows; it knows desk, table"):
        drawer.draw([Large("sofa", (depth, width, height))], 0)
    with pytest.raises(InputError, match="'garage' is no kind of room that the model knows; it knows unknown, kitchen, office"):
        drawer.check(Large("desk", (depth, width, height), "garage"))
    drawer.check(Large("desk", (depth, width, height), "office"))
    strange, unknown = (Large("desk", (depth, width, height), room) for room in ("garage", "unknown"))
    assert same(*drawer.draw([strange], 0), *drawer.draw([unknown], 0))


@pytest.mark.parametrize("name", ["unet", "transformer", "atiss"])
def test_weights_of_another_model_are_refused(name: str) -> None:
    model = MODELS[name]
    arrays = {key: np.zeros(shape, dtype="<f2") for key, shape in shapes_of(model, ENCODING).items()} | ENCODING.arrays()
    first = min(arrays)
    others = {**arrays, first: np.zeros((1, 2, 3))}, {**arrays, "more": np.zeros(1)}, {key: arrays[key] for key in arrays if key != first}
    for changed in others:
        with pytest.raises(InputError, match="model\\.bin"):
            load(to_safetensors(changed), model, "model.bin")


@pytest.mark.parametrize(
    "model", [PhyScene(architecture=Transformer(width=20, heads=3)), DiffuScene(architecture=Unet(width=20)), Atiss(embedding=5, heads=4)]
)
def test_sizes_that_do_not_share_channels_are_refused(model) -> None:
    arrays = {name: np.zeros(shape, dtype="<f2") for name, shape in shapes_of(model, ENCODING).items()}
    with pytest.raises(InputError, match="do not share"):
        load(to_safetensors(arrays | ENCODING.arrays()), model)


@pytest.mark.whole
def test_layouts_are_drawn_where_torch_is_missing(tmp_path) -> None:
    model = MODELS["transformer"]
    arrays = {name: np.full(shape, 0.01, dtype="<f2") for name, shape in shapes_of(model, ENCODING).items()}
    (tmp_path / "weights").write_bytes(to_safetensors(arrays | ENCODING.arrays()))
    script = f"""
import sys
sys.modules.update(dict.fromkeys(("torch", "diffusers", "matplotlib")))
from tasks.synthesis.inference.drawer import load
from tasks.synthesis.layout import Large
from tests.tasks.synthesis.test_inference import MODELS
drawer = load(open({str(tmp_path / "weights")!r}, "rb").read(), MODELS["transformer"])
print(len(drawer.draw([Large("desk", (0.7, 1.4, 0.75), "office")] * 3, 0)))
"""
    made = subprocess.run([sys.executable, "-c", script], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    assert made.stdout.split() == ["3"]
