"""Networks of synthesis models: sets in, sets out, and what is empty or absent says nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.synthesis.model.config import Atiss, ClipText, DiffuScene, LearnedText, Noise, PhyScene, Transformer, Unet
from tasks.synthesis.model.encoding import encoding_of
from tasks.synthesis.model.presets import PRESETS
from tasks.synthesis.model.shapes import check_fit, shapes_of
from tasks.weights import from_safetensors
from tests.tasks.synthesis.drawn_layouts import layouts

torch = pytest.importorskip("torch")

TEXT = LearnedText(width=8)
UNET = Unet(width=16, levels=2, groups=4, heads=2, head_width=8, instance_width=4, crosses=True)
PLAIN = Transformer(width=16, layers=2, heads=2, feedforward=24)
ATISS = Atiss(slots=6, text=TEXT, embedding=4, layers=2, heads=2, feedforward=24, mixtures=3)
MODELS = {
    "unet": DiffuScene(slots=6, text=TEXT, architecture=UNET),
    "unet alike": DiffuScene(
        slots=6, text=TEXT, architecture=dataclasses.replace(UNET, instance_width=0, crosses=False), categories="numbers"
    ),
    "transformer": PhyScene(slots=6, text=TEXT, architecture=PLAIN),
    "atiss": ATISS,
}
ENCODING = encoding_of(layouts(30))


def network(model, encoding=ENCODING, seed=0):
    from tasks.training.systems.synthesis import network as made

    module = made(model, encoding, seed).eval()
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in module.parameters():  # zeros and ones would hide what they are added to and multiplied with
            parameter += 0.05 * torch.randn(parameter.shape, generator=generator)
    return module


def asked(module, values, generator=None):
    places = torch.tensor([0, 1, 1]), torch.tensor([1, 0, 2]), torch.tensor([False, True, False])
    with torch.no_grad():
        return module(values, torch.tensor([0, 7, 199]), *places)


@pytest.mark.parametrize("name", ["unet alike", "transformer"])
def test_what_a_denoiser_tells_goes_with_the_slots(name: str) -> None:
    module, values = network(MODELS[name]), torch.randn(3, 6, ENCODING.width, generator=torch.Generator().manual_seed(1))
    told = asked(module, values)
    order = [0, 3, 1, 5, 2, 4]
    torch.testing.assert_close(asked(module, values[:, order])[:, 1:], told[:, order][:, 1:], rtol=1e-4, atol=1e-5)
    # the large object is not one of them
    assert not torch.allclose(asked(module, values[:, [1, 0, 2, 3, 4, 5]])[:, 2:], told[:, 2:], atol=1e-3)


def test_slots_with_vectors_of_their_own_are_not_alike() -> None:
    module, values = network(MODELS["unet"]), torch.randn(3, 6, ENCODING.width)
    order = [0, 3, 1, 5, 2, 4]
    assert not torch.allclose(asked(module, values[:, order])[:, 1:], asked(module, values)[:, order][:, 1:], atol=1e-3)


@pytest.mark.parametrize("name", ["unet", "unet alike", "transformer"])
def test_every_slot_hears_of_every_slot_the_step_and_the_text_and_no_layout_of_another(name: str) -> None:
    module = network(MODELS[name])
    values = torch.randn(3, 6, ENCODING.width, generator=torch.Generator().manual_seed(1))
    large, room, steps = torch.tensor([0, 1, 0]), torch.tensor([1, 0, 2]), torch.tensor([3, 3, 3])
    with torch.no_grad():
        told = module(values, steps, large, room)
        for slot in range(6):
            other = values.clone()
            other[0, slot] += 1.0
            change = (module(other, steps, large, room) - told).abs().amax(dim=-1)
            assert change[0, 1:].min() > 1e-6
            assert change[1:].max() == 0
        assert (module(values, steps + 50, large, room) - told).abs().amax(dim=-1).min() > 1e-6
        assert (module(values, steps, 1 - large, room) - told)[:, 1:].abs().amax(dim=-1).min() > 1e-6
        null = torch.tensor([True, False, False])
        hidden = module(values, steps, large, room, null)
        assert not torch.equal(hidden[0], told[0])
        assert torch.equal(hidden[1:], told[1:])
        torch.testing.assert_close(module(values, steps, 1 - large, 2 - room, null)[0], hidden[0])


@pytest.mark.parametrize("target", ["v", "eps"])
def test_chances_are_those_of_a_prior_and_of_the_noise(target: str) -> None:
    module = network(dataclasses.replace(MODELS["transformer"], noise=Noise(target=target)))
    prior = np.arange(1.0, len(ENCODING.classes) + 2)
    with torch.no_grad():
        module.class_out[-1].weight.zero_()
        module.class_out[-1].bias.copy_(torch.from_numpy(np.log(prior)))
    steps = torch.tensor([20, 100, 199])
    left = np.cumprod(1 - np.linspace(1e-5**0.5, 0.1**0.5, 200) ** 2)[steps.numpy()][:, None, None]
    one_hot = 2.0 * np.eye(len(prior)) - 1.0
    rng = np.random.default_rng(0)
    noised = np.sqrt(left) * one_hot[rng.integers(len(prior), size=(3, 6))] + np.sqrt(1 - left) * rng.normal(size=(3, 6, len(prior)))
    values = torch.zeros(3, 6, ENCODING.width)
    values[..., 8:] = torch.from_numpy(noised)
    with torch.no_grad():
        told = module(values, steps, torch.zeros(3, dtype=torch.long), torch.zeros(3, dtype=torch.long))[..., 8:].double().numpy()
    density = np.exp(-0.5 * np.square(noised[..., None, :] - np.sqrt(left)[..., None] * one_hot).sum(axis=-1) / (1 - left)) * prior
    clean = (density / density.sum(axis=-1, keepdims=True)) @ one_hot
    noise = (noised - np.sqrt(left) * clean) / np.sqrt(1 - left)
    expected = noise if target == "eps" else np.sqrt(left) * noise - np.sqrt(1 - left) * clean
    np.testing.assert_allclose(told, expected, atol=2e-3)


def sets(seed=0):
    generator = torch.Generator().manual_seed(seed)
    classes = torch.randint(0, len(ENCODING.classes), (3, 6), generator=generator)
    boxes = 2 * torch.rand(3, 6, 7, generator=generator) - 1
    there = torch.arange(6) < torch.tensor([[1], [4], [6]])
    return classes, boxes, there, torch.tensor([0, 1, 1]), torch.tensor([1, 0, 2])


def test_atiss_sees_a_set_behind_the_large_object_and_nothing_of_what_is_absent() -> None:
    module, (classes, boxes, there, large, room) = network(ATISS), sets()
    with torch.no_grad():
        hidden = module.hidden(classes, boxes, there, large, room)
        order = [0, 3, 1, 2, 5, 4]
        again = module.hidden(classes[2:, order], boxes[2:, order], there[2:, order], large[2:], room[2:])
        torch.testing.assert_close(again, hidden[2:], rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(module.hidden(classes[1:2, :4], boxes[1:2, :4], there[1:2, :4], large[1:2], room[1:2]), hidden[1:2])
        other, odd = boxes.clone(), classes.clone()
        other[~there], odd[~there] = 77.0, 0
        torch.testing.assert_close(module.hidden(odd, other, there, large, room), hidden)
        swapped = [1, 0, 2, 3, 4, 5]
        assert not torch.allclose(module.hidden(classes[2:, swapped], boxes[2:, swapped], there[2:], large[2:], room[2:]), hidden[2:])


def test_every_number_of_atiss_sees_those_before_it_alone() -> None:
    module, given = network(ATISS), sets()
    category, box = torch.tensor([0, 1, 2]), torch.rand(3, 7, generator=torch.Generator().manual_seed(2))
    with torch.no_grad():
        made = module(*given, category, box)
        for number, seen in ((0, {"angle", "size"}), (6, {"size"}), (4, set())):
            other = box.clone()
            other[:, number] -= 0.3
            again = module(*given, category, other)
            assert {name for name in made if not torch.equal(made[name], again[name])} == seen
        again = module(*given, (category + 1) % 3, box)
        assert {name for name in made if not torch.equal(made[name], again[name])} == {"translation", "angle", "size"}


def test_the_chances_of_all_bins_are_one_and_a_bins_is_that_of_a_logistic() -> None:
    from tasks.synthesis.model.networks.atiss import log_likelihood

    generator = torch.Generator().manual_seed(0)
    values = (3.0 * torch.randn(40, 12, generator=generator)).double()
    bins = torch.linspace(-1, 1, 256, dtype=torch.float64)
    chances = log_likelihood(values[:, None].expand(-1, 256, -1), bins.expand(40, -1)).exp()
    torch.testing.assert_close(chances.sum(dim=1), torch.ones(40, dtype=torch.float64), rtol=1e-6, atol=0)
    weights, middles, scales = values[0].numpy().reshape(3, 4)
    shares = np.exp(weights) / np.exp(weights).sum()
    below = lambda x: (shares / (1 + np.exp(-(x - middles) / np.exp(np.maximum(scales, -7))))).sum()  # noqa: E731
    edges = (bins.numpy()[1:] + bins.numpy()[:-1]) / 2
    expected = np.diff([0.0, *map(below, edges), 1.0])
    np.testing.assert_allclose(chances[0].numpy(), expected, rtol=1e-6, atol=1e-9)


def test_drawn_numbers_are_spread_as_their_chances_are() -> None:
    from tasks.synthesis.model.networks.atiss import drawn_number, log_likelihood

    values = torch.tensor([0.0, 1.0, -0.4, 0.5, -3.0, -2.0])
    drawn = drawn_number(values.expand(20_000, 6), torch.Generator().manual_seed(0))
    bins = torch.linspace(-1, 1, 256)
    chances = log_likelihood(values.expand(256, -1), bins).exp()
    below = (drawn[:, None] <= bins + 1 / 255).double().mean(dim=0)
    assert (below - chances.cumsum(dim=0)).abs().max() < 0.015  # Kolmogorov's distance at a chance of a ten-thousandth


def test_weights_have_the_shapes_that_are_said_without_torch() -> None:
    clip = dataclasses.replace(ATISS, text=ClipText(width=16))
    for model in [*MODELS.values(), clip]:
        module = network(model)
        assert shapes_of(model, ENCODING) == {name: tuple(values.shape) for name, values in module.state_dict().items()}
    arrays = {name: np.zeros(shape) for name, shape in shapes_of(ATISS, ENCODING).items()} | ENCODING.arrays()
    assert check_fit(arrays, ATISS, "file").classes == ENCODING.classes
    for change, problem in (
        ({"query": None}, "query: is missing"),
        ({"more": np.zeros(2)}, "is unknown"),
        ({"query": np.zeros(2)}, "shape"),
    ):
        with pytest.raises(InputError, match=problem):
            check_fit({name: value for name, value in {**arrays, **change}.items() if value is not None}, ATISS, "file")


def test_published_sizes_are_what_the_specs_say() -> None:
    from tasks.micro_scenes.categories import read_categories

    encoding = encoding_of(layouts(30), read_categories().names)
    assert encoding.width == 69
    atiss = shapes_of(PRESETS["atiss-paper"], encoding)
    assert atiss["class_out.weight"] == (62, 512)
    assert atiss["object_in.weight"] == (512, 512)
    assert [atiss[f"heads.translation.0.{i}.weight"] for i in (0, 2, 4)] == [(1152, 576), (576, 1152), (30, 576)]
    unet = shapes_of(PRESETS["diffuscene-paper"], encoding)
    assert [unet[f"box_in.{i}.weight"] for i in (0, 2, 4)] == [(512, 8), (1024, 512), (512, 1024)]
    assert unet["body.instances"] == (24, 128)
    assert unet["step.0.weight"] == (2048, 512)
    assert unet["body.down.3.attention.query.weight"] == (128, 512)
    # what noise is at the end and at the beginning
    for name, model in PRESETS.items():
        if hasattr(model, "noise"):
            left = np.cumprod(1 - np.linspace(model.noise.beta_low, model.noise.beta_high, model.noise.steps))
            assert left[-1] < 1e-4, name
            assert left[0] > 0.99


def theirs(config: Atiss, classes: int):
    """A made-up checkpoint of ATISS."""
    width, part = config.width, config.embedding
    rng = np.random.default_rng(0)
    shapes = {"fc_class": (part, classes), "fc": (width, 8 * part), "hidden2output.fc_class": (part, classes)}
    shapes |= {"hidden2output.class_layer": (classes, width), "fc_room_f": (width, 9), "feature_extractor.conv1": (4, 3)}
    for axis in "xyz":
        for place, (inside, outside) in {0: (1, 2), 2: (2, 1)}.items():
            for word, parts in (("centroid", 1), ("size", 5)):
                own = width + parts * part
                shapes[f"hidden2output.{word}_layer_{axis}.{place}"] = (outside * own, inside * own)
                shapes[f"hidden2output.{word}_layer_{axis}.4"] = (3 * config.mixtures, own)
    own = width + 4 * part
    shapes |= {
        f"hidden2output.angle_layer.{i}": s for i, s in {0: (2 * own, own), 2: (own, 2 * own), 4: (3 * config.mixtures, own)}.items()
    }
    for layer in range(config.layers):
        at = f"transformer_encoder.layers.{layer}"
        shapes |= {f"{at}.attention.{part}_projection": (width, width) for part in ("query", "key", "value", "out")}
        shapes |= {f"{at}.linear1": (config.feedforward, width), f"{at}.linear2": (width, config.feedforward)}
        shapes |= {f"{at}.norm1": (width,), f"{at}.norm2": (width,)}
    arrays = {f"{name}.weight": rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}
    arrays |= {
        f"{name}.bias": rng.normal(size=shape[:1]).astype(np.float32) for name, shape in shapes.items() if not name.endswith("fc_class")
    }
    return arrays | {"empty_token_embedding": rng.normal(size=(1, width)).astype(np.float32), "start_token_embedding": np.zeros((1, width))}


def test_weights_of_atiss_by_others_tell_the_same_in_another_frame(tmp_path) -> None:
    from tasks.synthesis.model.foreign import begin_with_foreign
    from tasks.synthesis.model.networks.blocks import waves
    from tasks.weights import to_safetensors

    arrays, module = theirs(ATISS, len(ENCODING.classes) + 2), network(ATISS)
    file = tmp_path / "atiss.safetensors"
    file.write_bytes(to_safetensors(arrays))
    assert "weights from atiss.safetensors" in begin_with_foreign(module, str(file))
    box, part = 2 * torch.rand(7, generator=torch.Generator().manual_seed(3)) - 1, ATISS.embedding
    there = box[[1, 2, 0, 4, 5, 3, 6]]  # their x, y, z are our y, z, x
    named = torch.zeros(len(ENCODING.classes) + 2)
    named[1] = 1.0
    seen = torch.cat([torch.from_numpy(arrays["fc_class.weight"]) @ named, waves(there, part).flatten()])
    expected = torch.from_numpy(arrays["fc.weight"]) @ seen + torch.from_numpy(arrays["fc.bias"])
    with torch.no_grad():
        own = module.object_in(torch.cat([module.class_in(named), waves(box, part).flatten()]))
        torch.testing.assert_close(own, expected)
        hidden = torch.randn(ATISS.width)
        ours = module.numbers(hidden[None], torch.tensor([1]), box[None, [0, 1, 2, 6]], "size")[0]
    told = torch.cat(
        [hidden, torch.from_numpy(arrays["hidden2output.fc_class.weight"]) @ named, waves(there[[0, 1, 2, 6]], part).flatten()]
    )
    for axis, letter in enumerate("zxy"):
        value = told
        for place in (0, 2, 4):
            name = f"hidden2output.size_layer_{letter}.{place}"
            value = torch.from_numpy(arrays[f"{name}.weight"]) @ value + torch.from_numpy(arrays[f"{name}.bias"])
            value = torch.nn.functional.gelu(value) if place < 4 else value
        torch.testing.assert_close(ours[axis], value, rtol=1e-4, atol=1e-3)
    for change, problem in (
        ({"odd.weight": np.zeros(2)}, "1 of its weights are unknown: odd.weight"),
        ({"fc.bias": None}, "are missing: fc.bias"),
    ):
        file.write_bytes(to_safetensors({name: value for name, value in {**arrays, **change}.items() if value is not None}))
        with pytest.raises(InputError, match=problem):
            begin_with_foreign(module, str(file))
    with pytest.raises(InputError, match="is not known how to be read into physcene"):
        begin_with_foreign(network(MODELS["transformer"]), str(file))
    assert from_safetensors(file.read_bytes())
