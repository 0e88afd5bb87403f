"""Weights of DiffuScene and PhyScene that others trained: the network tells here what it told there, in the frame here."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.synthesis.model.config import DiffuScene, LearnedText, PhyScene, Transformer, Unet
from tasks.synthesis.model.encoding import BOX, encoding_of
from tasks.synthesis.model.presets import PRESETS
from tasks.synthesis.model.shapes import shapes_of
from tests.tasks.synthesis.drawn_layouts import layouts

torch = pytest.importorskip("torch")
functional = torch.nn.functional

ENCODING = encoding_of(layouts(30))
UNET = Unet(width=16, levels=2, groups=4, heads=2, head_width=8, instance_width=4, crosses=True)
SLOTS = 6
TEXT = LearnedText(width=8)
DIFFUSCENE = DiffuScene(slots=SLOTS, text=TEXT, architecture=UNET, categories="numbers")
PHYSCENE = PhyScene(slots=SLOTS, text=TEXT, architecture=UNET, categories="numbers")
THEIRS = [1, 2, 0, 4, 5, 3, 6, 7]
"""Our number for each of theirs: their x, y, z are our y, z, x."""


def shapes_there(shape: Unet, classes: int, slots: int, *, latents: int = 0, plan: int = 0, texts: int = 0) -> dict[str, tuple[int, ...]]:
    """Shapes by name, as a checkpoint has them. classes: With `empty`. latents, plan, texts: Widths of what is read, 0: nothing."""
    width, inner = shape.width, shape.heads * shape.head_width
    shapes: dict[str, tuple[int, ...]] = {"positional_embedding": (slots, shape.instance_width)}

    def layer(name: str, outside: int, *inside: int) -> None:
        shapes[f"diffusion.model.{name}.weight"], shapes[f"diffusion.model.{name}.bias"] = (outside, *inside), (outside,)

    def block(name: str, told: int, inside: int = width) -> None:
        layer(f"{name}.mlp.1", 2 * width, told)
        for number, read in ((1, inside), (2, width)):
            layer(f"{name}.block{number}.proj", width, read, 1)
            layer(f"{name}.block{number}.norm", width)
        if inside != width:
            layer(f"{name}.res_conv", width, inside, 1)

    def attention(name: str, *, linear: bool = True, crosses: bool = False) -> None:
        at = f"diffusion.model.{name}.fn"
        shapes[f"{at}.norm.g"] = (1, width, 1)
        if crosses:
            shapes[f"{at}.fn.to_q.weight"], shapes[f"{at}.fn.to_kv.weight"] = (inner, width, 1), (2 * inner, texts, 1)
        else:
            shapes[f"{at}.fn.to_qkv.weight"] = (3 * inner, width, 1)
        layer(f"{name}.fn.fn.to_out.0" if linear else f"{name}.fn.fn.to_out", width, inner, 1)
        if linear:
            shapes[f"{at}.fn.to_out.1.g"] = (1, width, 1)

    layer("time_mlp.1", 4 * width, width)
    layer("time_mlp.3", 4 * width, 4 * width)
    layer("init_conv", width, width, 1)
    for part, size in (("bbox", BOX), ("class", classes), ("objfeat", latents)):
        for place, (outside, inside) in enumerate(((width, size), (2 * width, width), (width, 2 * width)) if size else ()):
            layer(f"{part}_embedf.{2 * place}", outside, inside, 1)
        for place, (outside, inside) in enumerate(((2 * width, width), (width, 2 * width), (size, width)) if size else ()):
            layer(f"{part}_hidden2output.{2 * place}", outside, inside, 1)
    for side, inside in (("downs", width), ("ups", 2 * width)):
        for level in range(shape.levels):
            at = f"{side}.{level}"
            block(f"{at}.0", plan + shape.instance_width)
            block(f"{at}.1", 4 * width, inside)
            block(f"{at}.3", 4 * width, inside)
            attention(f"{at}.4")
            if texts:
                attention(f"{at}.2", crosses=True)
        layer(f"{side}.{shape.levels - 1}.5", width, width, 1)
    block("mid_block0", plan + shape.instance_width)
    block("mid_block1", 4 * width)
    block("mid_block2", 4 * width)
    attention("mid_attn", linear=False)
    if texts:
        attention("mid_attn_cross", crosses=True)
        shapes |= {"fc_text_f.weight": (texts, 9), "fc_text_f.bias": (texts,), "bertmodel.embeddings.word_embeddings.weight": (3, 9)}
    block("final_res_block", 4 * width, 2 * width)
    if plan:
        shapes |= {"fc_room_f.weight": (plan, 5), "fc_room_f.bias": (plan,), "feature_extractor.conv1.weight": (2, 1, 3, 3)}
    return shapes


class Upstream:
    """What a checkpoint's network tells, of vectors (b, d, s) in its own order. weights: By its names."""

    def __init__(self, weights: Mapping[str, Any], shape: Unet) -> None:
        self.weights, self.shape = weights, shape

    def layer(self, name: str, values: Any, *, is_standard: bool = False) -> Any:
        weight, bias = (self.weights.get(f"diffusion.model.{name}.{kind}") for kind in ("weight", "bias"))
        if is_standard:
            weight = functional.layer_norm(weight, weight.shape[1:])
        return functional.linear(values, weight, bias) if weight.ndim == 2 else functional.conv1d(values, weight, bias)

    def layers(self, name: str, values: Any) -> Any:
        for place in (0, 2):
            values = functional.gelu(self.layer(f"{name}.{place}", values))
        return self.layer(f"{name}.4", values)

    def norm(self, name: str, values: Any) -> Any:
        middle = values - values.mean(dim=1, keepdim=True)
        return middle / (middle.square().mean(dim=1, keepdim=True) + 1e-5).sqrt() * self.weights[f"diffusion.model.{name}.g"]

    def block(self, name: str, values: Any, told: Any) -> Any:
        """told: Of all slots (b, c), or of each (b, s, c)."""
        told = self.layer(f"{name}.mlp.1", functional.silu(told))
        scale, shift = (told.mT if told.ndim == 3 else told[:, :, None]).split(self.shape.width, dim=1)
        made = values
        for number in (1, 2):
            own = f"{name}.block{number}"
            gain, bias = (self.weights[f"diffusion.model.{own}.norm.{kind}"] for kind in ("weight", "bias"))
            made = functional.group_norm(self.layer(f"{own}.proj", made, is_standard=True), self.shape.groups, gain, bias)
            made = functional.silu(made * (1 + scale) + shift if number == 1 else made)
        return made + (self.layer(f"{name}.res_conv", values) if f"diffusion.model.{name}.res_conv.weight" in self.weights else values)

    def attention(self, name: str, values: Any, tokens: Any = None, *, linear: bool = True) -> Any:
        normed = self.norm(f"{name}.fn.norm", values)
        if tokens is None:
            query, key, value = self.layer(f"{name}.fn.fn.to_qkv", normed).tensor_split(3, dim=1)
        else:
            query = self.layer(f"{name}.fn.fn.to_q", normed)
            key, value = self.layer(f"{name}.fn.fn.to_kv", tokens).tensor_split(2, dim=1)
        query, key, value = (part.unflatten(1, (self.shape.heads, self.shape.head_width)) for part in (query, key, value))
        root = math.sqrt(self.shape.head_width)
        if linear:
            mixed = torch.einsum("bhcs,bhct,bhdt->bhds", query.softmax(dim=2), key.softmax(dim=3), value) / root
            return values + self.norm(f"{name}.fn.fn.to_out.1", self.layer(f"{name}.fn.fn.to_out.0", mixed.flatten(1, 2)))
        shares = (torch.einsum("bhcs,bhct->bhst", query, key) / root).softmax(dim=3)
        return values + self.layer(f"{name}.fn.fn.to_out", torch.einsum("bhst,bhdt->bhds", shares, value).flatten(1, 2))

    def level(self, name: str, values: Any, instances: Any, time: Any, texts: Any, across: list[Any] | None) -> tuple[Any, Any, Any]:
        values = self.block(f"{name}.0", values, instances)
        first = self.block(f"{name}.1", values if across is None else torch.cat([values, across.pop()], dim=1), time)
        values = first if texts is None else self.attention(f"{name}.2", first, texts)
        values = self.block(f"{name}.3", values if across is None else torch.cat([values, across.pop()], dim=1), time)
        second = self.attention(f"{name}.4", values)
        is_last = f"diffusion.model.{name}.5.weight" in self.weights
        return (self.layer(f"{name}.5", second) if is_last else second), first, second

    def __call__(self, vectors: Any, steps: Any, classes: int, texts: Any, plan: int) -> Any:
        parts = vectors.split([BOX, classes, vectors.shape[1] - BOX - classes], dim=1)
        present = [name for name, part in zip(("bbox", "class", "objfeat"), parts, strict=True) if part.shape[1]]
        read = sum(self.layers(f"{name}_embedf", part) for name, part in zip(present, parts, strict=False))
        start = values = self.layer("init_conv", read)
        half = self.shape.width // 2
        phases = steps[:, None] * 10_000.0 ** (-torch.arange(half) / (half - 1))
        time = self.layer("time_mlp.3", functional.gelu(self.layer("time_mlp.1", torch.cat([phases.sin(), phases.cos()], dim=1))))
        slots = self.weights["positional_embedding"].expand(len(vectors), -1, -1)
        instances = torch.cat([slots.new_zeros(*slots.shape[:2], plan), slots], dim=2)
        across: list[Any] = []
        for level in range(self.shape.levels):
            values, *left = self.level(f"downs.{level}", values, instances, time, texts, None)
            across += left
        values = self.block("mid_block1", self.block("mid_block0", values, instances), time)
        values = values if texts is None else self.attention("mid_attn_cross", values, texts)
        values = self.block("mid_block2", self.attention("mid_attn", values, linear=False), time)
        for level in range(self.shape.levels):
            values, *_ = self.level(f"ups.{level}", values, instances, time, texts, across)
        values = self.block("final_res_block", torch.cat([values, start], dim=1), time)
        return torch.cat([self.layers(f"{name}_hidden2output", values) for name in present], dim=1)


def network(config: Any, seed: int = 0) -> Any:
    from tasks.training.systems.synthesis import network as made

    return made(config, ENCODING, seed).eval()


def drawn(shapes: Mapping[str, tuple[int, ...]], seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        name: (0.3 * rng.normal(size=shape) + (1.0 if name.endswith((".g", ".norm.weight")) else 0.0)).astype(np.float32)
        for name, shape in shapes.items()
    }


def begun(tmp_path: Any, config: Any, arrays: Mapping[str, np.ndarray], module: Any = None) -> tuple[Any, str]:
    """A network that began with a checkpoint that torch wrote, and what is said of it."""
    from tasks.synthesis.model.foreign import begin_with_foreign

    file, module = tmp_path / "model_00100", module or network(config)
    torch.save({name: torch.from_numpy(array) for name, array in arrays.items()}, file)
    return module, begin_with_foreign(module, str(file))


CASES = {
    "diffuscene of texts and shapes": (DIFFUSCENE, {"latents": 5, "texts": 8}),
    "diffuscene of nothing": (DIFFUSCENE, {}),
    "physcene of floor plans and shapes": (PHYSCENE, {"latents": 3, "plan": 7}),
    "physcene that looks at no text": (dataclasses.replace(PHYSCENE, architecture=dataclasses.replace(UNET, crosses=False)), {"plan": 7}),
    "diffuscene of three levels": (dataclasses.replace(DIFFUSCENE, architecture=dataclasses.replace(UNET, levels=3)), {"texts": 8}),
}


@pytest.mark.parametrize("name", CASES)
def test_a_network_tells_what_it_told_there_in_another_frame(name: str, tmp_path) -> None:
    config, parts = CASES[name]
    classes = len(ENCODING.classes) + 1
    arrays = drawn(shapes_there(config.architecture, classes, SLOTS, **parts))
    module, line = begun(tmp_path, config, arrays)
    generator = torch.Generator().manual_seed(1)
    values, steps = torch.randn(3, SLOTS, ENCODING.width, generator=generator), torch.tensor([0, 7, 199])
    large, room = torch.tensor([0, 1, 1]), torch.tensor([1, 0, 2])
    with torch.no_grad():
        told = module(values, steps, large, room)
        texts = module.text(large, room)[:, :, None] if parts.get("texts") else None
        there = torch.cat([values[..., THEIRS], values[..., BOX:], torch.zeros(3, SLOTS, parts.get("latents", 0))], dim=-1)
        upstream = Upstream({name: torch.from_numpy(array) for name, array in arrays.items()}, config.architecture)
        expected = upstream(there.mT, steps, classes, texts, parts.get("plan", 0)).mT
    torch.testing.assert_close(told[..., THEIRS], expected[..., :BOX], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(told[..., BOX:], expected[..., BOX : BOX + classes], rtol=1e-4, atol=1e-4)
    assert expected.std() > 0.1
    assert "weights from model_00100; " in line
    assert ("floor plan" in line) == ("plan" in parts)
    assert ("shapes of objects" in line) == ("latents" in parts)
    assert ("encoder of texts" in line) == ("texts" in parts)
    assert ("attention to texts" in line) == ("texts" not in parts and config.architecture.crosses)
    assert "anew" not in line


def test_names_of_several_graphics_cards_and_safetensors_are_read_alike(tmp_path) -> None:
    from tasks.synthesis.model.foreign import begin_with_foreign
    from tasks.weights import to_safetensors

    arrays = drawn(shapes_there(UNET, len(ENCODING.classes) + 1, SLOTS, texts=8))
    module, line = begun(tmp_path, DIFFUSCENE, arrays)
    file, other = tmp_path / "model_00100.safetensors", network(DIFFUSCENE)
    file.write_bytes(to_safetensors({f"module.{name}": array for name, array in arrays.items()}))
    assert begin_with_foreign(other, str(file)) == line.replace("model_00100", "model_00100.safetensors")
    for name, value in other.state_dict().items():
        assert torch.equal(value, module.state_dict()[name])


def test_what_is_counted_otherwise_is_drawn_anew_and_named(tmp_path) -> None:
    drawn_module = network(DIFFUSCENE)
    before = {name: value.clone() for name, value in drawn_module.state_dict().items()}
    arrays = drawn(shapes_there(UNET, len(ENCODING.classes) + 4, SLOTS + 3, texts=8))
    module, line = begun(tmp_path, DIFFUSCENE, arrays, drawn_module)
    anew = {"class_in.0.weight", "class_out.4.weight", "class_out.4.bias", "body.instances"}
    assert {*line.split("drawn anew, as slots or categories are other ones: ")[1].split(", ")} == anew
    for name in anew:
        assert torch.equal(module.state_dict()[name], before[name])
    assert torch.equal(module.class_in[0].bias, torch.from_numpy(arrays["diffusion.model.class_embedf.0.bias"]))


UNKNOWN = "1 of its weights are unknown: fc_partial_condition.0.weight"
REFUSED = {
    "unknown": ({"fc_partial_condition.0.weight": (2, 2)}, UNKNOWN),
    "missing": ({"diffusion.model.mid_block0.mlp.1.bias": None}, "1 of its weights are missing: diffusion.model.mid_block0.mlp.1.bias"),
    "missing slots": ({"positional_embedding": None}, "are missing: positional_embedding"),
    "texts in part": ({"diffusion.model.ups.0.2.fn.fn.to_q.weight": None}, "are missing: diffusion.model.ups.0.2.fn.fn.to_q.weight"),
    "latents in part": ({"diffusion.model.objfeat_embedf.2.bias": None}, "are missing: objfeat_embedf.2.bias"),
    "one angle": ({"diffusion.model.bbox_embedf.0.weight": (16, 7, 1)}, r"has the shape \(16, 7, 1\); the config wants \(16, 8\)"),
    "neighbors": ({"diffusion.model.downs.1.1.block1.proj.weight": (16, 16, 3)}, r"has the shape \(16, 16, 3\)"),
    "wider": ({"diffusion.model.init_conv.weight": (16, 20, 1)}, r"has the shape \(16, 20, 1\); the config wants \(16, 16\)"),
    "wider latents": ({"diffusion.model.objfeat_embedf.2.weight": (32, 18, 1)}, r"has the shape \(32, 18, 1\)"),
    "a number": ({"diffusion.model.objfeat_embedf.0.weight": ()}, r"has the shape \(\)"),
    "more heads": ({"diffusion.model.mid_attn.fn.fn.to_qkv.weight": (96, 16, 1)}, r"has the shape \(96, 16, 1\)"),
    "a flat one": ({"diffusion.model.downs.0.0.mlp.1.weight": (32,)}, r"has the shape \(32,\)"),
    "a plan that nothing reads": ({"fc_room_f.weight": (3, 5)}, r"has the shape \(32, 4\)"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_other_weights_are_refused_by_name(name: str, tmp_path) -> None:
    change, problem = REFUSED[name]
    arrays = drawn(shapes_there(UNET, len(ENCODING.classes) + 1, SLOTS, latents=5, texts=8))
    for key, shape in change.items():
        arrays = {**arrays, key: np.zeros(shape, np.float32)} if shape is not None else {k: v for k, v in arrays.items() if k != key}
    module = network(DIFFUSCENE)
    before = {key: value.clone() for key, value in module.state_dict().items()}
    with pytest.raises(InputError, match=problem):
        begun(tmp_path, DIFFUSCENE, arrays, module)
    assert all(torch.equal(value, before[key]) for key, value in module.state_dict().items())


@pytest.mark.parametrize(
    ("config", "problem"),
    [
        (dataclasses.replace(PHYSCENE, architecture=Transformer(width=16, heads=2)), "into physcene with a transformer"),
        (dataclasses.replace(DIFFUSCENE, categories="chances"), "that tells categories as chances"),
        (
            dataclasses.replace(DIFFUSCENE, architecture=dataclasses.replace(UNET, crosses=False)),
            "are unknown: diffusion.model.downs.0.2.fn",
        ),
        (
            dataclasses.replace(DIFFUSCENE, architecture=dataclasses.replace(UNET, instance_width=0)),
            "are unknown: diffusion.model.downs.0.0",
        ),
        (dataclasses.replace(DIFFUSCENE, architecture=dataclasses.replace(UNET, width=32)), "has the shape"),
        (
            dataclasses.replace(DIFFUSCENE, text=LearnedText(width=12)),
            r"to_kv.weight: has the shape \(32, 8, 1\); .* \(32, 12\)",
        ),
    ],
)
def test_networks_that_are_made_otherwise_are_refused(config: Any, problem: str, tmp_path) -> None:
    with pytest.raises(InputError, match=problem):
        begun(tmp_path, config, drawn(shapes_there(UNET, len(ENCODING.classes) + 1, SLOTS, latents=5, texts=8)))


@pytest.mark.parametrize(
    ("preset", "parts"), [("diffuscene-paper", {"latents": 32, "texts": 512}), ("physcene-paper", {"latents": 32, "plan": 512})]
)
def test_networks_of_the_published_size_take_all_names(preset: str, parts: dict[str, int]) -> None:
    from tasks.synthesis.model.foreign.denoiser import from_denoiser

    config = PRESETS[preset]
    encoding = dataclasses.replace(ENCODING, classes=tuple(f"category {i}" for i in range(60)))
    shapes = shapes_of(config, encoding)
    there = shapes_there(config.architecture, 61, config.slots, **parts)
    made, line = from_denoiser({name: np.broadcast_to(np.float32(0), shape) for name, shape in there.items()}, config, shapes, "file")
    assert {name: array.shape for name, array in made.items()} == {name: shapes[name] for name in made}
    left = {name for name in shapes if name not in made and not (".text." in name or "middle_text" in name)}
    assert left == {"null", "text.large.weight", "text.room.weight", "condition.0.weight", "condition.0.bias"}
    of_texts = {name.rsplit(".", 2)[-2] for name in shapes.keys() - made.keys() if ".text." in name}
    assert of_texts == (set() if "texts" in parts else {"norm", "query", "key_value", "out"})
    assert "anew" not in line
