"""Weights of DiffuScene and PhyScene that others trained, by the names in their checkpoints: one denoiser, which PhyScene has without text.

Here its architecture is `unet`. Below `diffusion.model.` there and `body.` here, with i for a level:

| there | here |
|---|---|
| `{downs,ups}.i.{0,1,3}` | `{down,up}.i.{instance,first,second}` |
| `mid_block{0,1,2}`, `final_res_block` | `middle_{instance,first,second}`, `last` |
| of such a block `mlp.1`, `res_conv` | `film`, `shortcut` |
| of such a block `block{1,2}.proj`, `block{1,2}.norm` | `first`, `second`, `first_norm`, `second_norm` |
| `{downs,ups}.i.{2,4}` | `{down,up}.i.{text,attention}` |
| `mid_attn_cross`, `mid_attn` | `middle_text`, `middle_attention` |
| of such an attention `fn.norm.g`, `fn.fn.{to_qkv,to_q,to_kv}` | `norm`, `query`, `key_value` |
| of such an attention `fn.fn.to_out`, of linear ones `fn.fn.to_out.{0,1}` | `out`, `out_norm` |
| `{downs,ups}.i.5` of the last level; other levels have none | `{down,up}.i.out`; in other levels it leaves all as it is at first |

Elsewhere:

| there | here |
|---|---|
| `diffusion.model.time_mlp.{1,3}` | `step.{0,2}` |
| `diffusion.model.{bbox,class}_embedf.{0,2,4}`, the last one through `init_conv` | `{box,class}_in.{0,2,4}` |
| `diffusion.model.{bbox,class}_hidden2output.{0,2,4}` | `{box,class}_out.{0,2,4}` |
| `diffusion.model.objfeat_embedf`, of latents of 0 | in the bias of `box_in.4` |
| `positional_embedding` | `body.instances` |
| `diffusion.model.objfeat_hidden2output` | left out: shapes of objects are not drawn here |
| `feature_extractor`, `fc_room_f`, and columns of `mlp.1` that read a floor plan | left out: there is none here |
| `fc_text_f`, `bertmodel`, `clip_model` | left out: texts have an encoder of their own here |

What is told here beside that, of the large object with the step, and texts where the checkpoint has none, begins without effect. All that
is in neither column refuses the file, so that every weight of the levels finds its place. Vectors of slots and what reads or tells
categories are drawn anew where their number is another one; else slots and categories are taken to be in the same order, `empty` last.

There +Y is up and the front is +Z: its z, x, y are x, y, z here; extents are halves, and the yaw is its cosine and sine, as here. A file
has no bounds, by which numbers are scaled, and does not say whether the noise or the velocity is told. Heights there are those of middles
above the floor: begin with `heights` as `middles`, else what a file says of heights has to be learned anew.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.synthesis.inference.layers import Layers, one_thread
from tasks.synthesis.model.config import Diffusion, Unet
from tasks.synthesis.model.encoding import BOX
from tasks.synthesis.model.foreign.names import Arrays, check_names, turned, wrong_shape

OUTER = "diffusion.model."
"""Before the names of the denoiser's own weights."""

PARALLEL = "module."
"""Before all names, where several graphics cards trained."""

LEFT_OUT = {
    "what of it reads a floor plan": ("feature_extractor.", "fc_room_f."),
    "shapes of objects": (f"{OUTER}objfeat_embedf.", f"{OUTER}objfeat_hidden2output."),
    "its encoder of texts": ("fc_text_f.", "bertmodel.", "clip_model."),
}
"""First parts of names that have no place here, by what they are."""

COUNTED = {"class_in.0.weight": 1, "class_out.4.weight": 0, "class_out.4.bias": 0, "body.instances": 0}
"""Weights of which an axis counts categories or slots."""

PLAN, LATENT, INPUT, SLOTS = "fc_room_f.weight", "objfeat_embedf", f"{OUTER}init_conv", "positional_embedding"
TEXTS = re.compile(r"\.(\d+\.text|middle_text)\.")

RESTING = re.compile(r"^condition\.2\.|^body\.(down|up)\.\d+\.out\.|norm\.bias$|\.out_norm\.weight$")
"""What tells of the large object, last layers of levels, and of norms what theirs do not have and what is behind attention to texts."""


def their_names(shape: Unet) -> dict[str, str]:
    """Names there by names here, of all weights but those of `init_conv` and of what is left out."""
    names = _layer("step.0", "time_mlp.1") | _layer("step.2", "time_mlp.3") | _block("body.last", "final_res_block", has_shortcut=True)
    for part, word in (("box", "bbox"), ("class", "class")):
        for place in (0, 2, 4):
            names |= _layer(f"{part}_in.{place}", f"{word}_embedf.{place}")
            names |= _layer(f"{part}_out.{place}", f"{word}_hidden2output.{place}")
    names |= _block("body.middle_first", "mid_block1") | _block("body.middle_second", "mid_block2")
    names |= _attention("body.middle_attention", "mid_attn", is_linear=False)
    if shape.instance_width:
        names |= _block("body.middle_instance", "mid_block0")
    if shape.crosses:
        names |= _attention("body.middle_text", "mid_attn_cross", crosses=True)
    for side in ("down", "up"):
        for level in range(shape.levels):
            here, there = f"body.{side}.{level}", f"{side}s.{level}"
            names |= _block(f"{here}.first", f"{there}.1", has_shortcut=side == "up")
            names |= _block(f"{here}.second", f"{there}.3", has_shortcut=side == "up")
            names |= _attention(f"{here}.attention", f"{there}.4")
            if shape.instance_width:
                names |= _block(f"{here}.instance", f"{there}.0")
            if shape.crosses:
                names |= _attention(f"{here}.text", f"{there}.2", crosses=True)
        names |= _layer(f"body.{side}.{shape.levels - 1}.out", f"{side}s.{shape.levels - 1}.5")
    names = {here: OUTER + there for here, there in names.items()}
    return names | ({"body.instances": SLOTS} if shape.instance_width else {})


def _layer(here: str, there: str) -> dict[str, str]:
    return {f"{here}.{kind}": f"{there}.{kind}" for kind in ("weight", "bias")}


def _block(here: str, there: str, *, has_shortcut: bool = False) -> dict[str, str]:
    names = _layer(f"{here}.film", f"{there}.mlp.1") | (_layer(f"{here}.shortcut", f"{there}.res_conv") if has_shortcut else {})
    for own, number in (("first", 1), ("second", 2)):
        names |= _layer(f"{here}.{own}", f"{there}.block{number}.proj") | _layer(f"{here}.{own}_norm", f"{there}.block{number}.norm")
    return names


def _attention(here: str, there: str, *, is_linear: bool = True, crosses: bool = False) -> dict[str, str]:
    inner = f"{there}.fn.fn"
    query, key_value = ("to_q", "to_kv") if crosses else ("to_qkv", "to_qkv")
    names = {f"{here}.query.weight": f"{inner}.{query}.weight", f"{here}.key_value.weight": f"{inner}.{key_value}.weight"}
    names |= {f"{here}.norm.weight": f"{there}.fn.norm.g"} | _layer(f"{here}.out", f"{inner}.to_out{'.0' if is_linear else ''}")
    return names | ({f"{here}.out_norm.weight": f"{inner}.to_out.1.g"} if is_linear else {})


def from_denoiser(
    arrays: Arrays, config: Diffusion, shapes: Mapping[str, tuple[int, ...]], file: str
) -> tuple[dict[str, NDArray[Any]], str]:
    """Weights of a checkpoint by the names here, in the frame here, and what is said of the rest.

    shapes: Of the network's weights, by their names.

    Raises:
        InputError: the network has another architecture or tells chances of categories; or some weights have names that nobody knows, are
            missing, or have another shape.
    """
    architecture = config.architecture
    if not isinstance(architecture, Unet) or config.categories != "numbers":
        problem = f"is not known how to be read into {config.kind} with a {architecture.kind} that tells categories as {config.categories}"
        raise InputError(file, "foreign", problem, f"train from scratch, or take {config.kind}-paper")
    arrays = {name.removeprefix(PARALLEL): array for name, array in arrays.items()}
    out = {what: [name for name in arrays if name.startswith(parts)] for what, parts in LEFT_OUT.items()}
    used = {name: array for name, array in arrays.items() if not any(name in names for names in out.values())}
    names = their_names(architecture)
    has_texts = any(name.endswith(".to_kv.weight") for name in used)
    if not has_texts:
        names = {here: there for here, there in names.items() if not TEXTS.search(here)}
    check_names(used, {*names.values(), *_layer(INPUT, INPUT)}, file, "DiffuScene or PhyScene")

    plan = len(arrays[PLAN]) if PLAN in arrays and arrays[PLAN].ndim else 0
    inner = architecture.heads * architecture.head_width
    made, anew = {}, []
    for here, there in names.items():
        array, wanted = _flat(there, used[there]), shapes[here]
        if array.ndim != len(wanted):
            raise wrong_shape(file, there, used[there].shape, wanted)
        if there.endswith("to_qkv.weight"):
            array = array[:inner] if here.endswith("query.weight") else array[inner:]
        elif here.endswith("instance.film.weight"):
            array = array[:, plan:]
        if array.shape == wanted:
            made[here] = array
        elif here in COUNTED and np.delete(array.shape, COUNTED[here]).tolist() == np.delete(wanted, COUNTED[here]).tolist():
            anew.append(here)
        else:
            raise wrong_shape(file, there, used[there].shape, wanted)
    made |= _entered(made, arrays, file)
    order = np.arange(BOX)
    for first in (0, 3):
        turned(order, first)
    made["box_in.0.weight"] = made["box_in.0.weight"][:, order]
    for kind in ("weight", "bias"):
        made[f"box_out.4.{kind}"] = made[f"box_out.4.{kind}"][order]

    resting = {name: _resting(name, shape) for name, shape in shapes.items() if name not in made and RESTING.search(name)}
    parts = [f"left out: {', '.join(what for what, is_left in out.items() if is_left)}"] if any(out.values()) else []
    silent = ["what is told of the large object"] + (["attention to texts"] if architecture.crosses and not has_texts else [])
    parts.append(f"without effect at first: {', '.join(silent)}")
    parts += [f"drawn anew, as slots or categories are other ones: {', '.join(anew)}"] if anew else []
    return made | resting, "; ".join(parts)


def _flat(name: str, array: NDArray[Any]) -> NDArray[Any]:
    """An array as a layer of single slots has it: theirs are convolutions one slot wide (o, i, 1), and scales of norms are (1, w, 1)."""
    if name.endswith(".g"):
        return array.reshape(-1)
    return array[..., 0] if array.ndim == 3 and array.shape[-1] == 1 else array


def _entered(made: Arrays, arrays: Arrays, file: str) -> dict[str, NDArray[Any]]:
    """The last layers of what reads boxes and categories, through the layer that follows their sum there.

    made: Weights by the names here. arrays: Of the checkpoint.

    Raises:
        InputError: that layer, or what reads latents there, has another shape.
    """
    width = len(made["box_in.4.bias"])
    weight, bias = (np.asarray(_flat(INPUT, arrays[f"{INPUT}.{kind}"]), dtype=np.float64) for kind in ("weight", "bias"))
    if weight.shape != (width, width) or bias.shape != (width,):
        raise wrong_shape(file, f"{INPUT}.weight", arrays[f"{INPUT}.weight"].shape, (width, width))
    bias = bias + weight @ _of_no_latents(arrays, width, file)
    entered = {f"{part}_in.4.weight": weight @ made[f"{part}_in.4.weight"] for part in ("box", "class")}
    return entered | {"box_in.4.bias": weight @ made["box_in.4.bias"] + bias, "class_in.4.bias": weight @ made["class_in.4.bias"]}


def _of_no_latents(arrays: Arrays, width: int, file: str) -> NDArray[Any]:
    """What the checkpoint's network reads out of latents of 0, shape (width,); zeros where it reads no latents.

    Raises:
        InputError: what reads them has another shape.
    """
    read = {name.removeprefix(OUTER): _flat(name, array) for name, array in arrays.items() if name.startswith(f"{OUTER}{LATENT}.")}
    if not read:
        return np.zeros(width)
    given = read[f"{LATENT}.0.weight"].shape[-1:] if f"{LATENT}.0.weight" in read else ()
    wanted: dict[str, tuple[int, ...]] = {}
    for place, shape in ((0, (width, *given)), (2, (2 * width, width)), (4, (width, 2 * width))):
        wanted |= {f"{LATENT}.{place}.weight": shape, f"{LATENT}.{place}.bias": shape[:1]}
    check_names(read, wanted, file, "DiffuScene or PhyScene")
    for name, shape in wanted.items():
        if read[name].shape != shape:
            raise wrong_shape(file, OUTER + name, arrays[OUTER + name].shape, shape)
    layers = Layers({name: np.asarray(array, dtype=np.float32) for name, array in read.items()})
    with one_thread():
        return layers.perceptron(LATENT, np.zeros((1, *given), dtype=np.float32))[0]


def _resting(name: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """A weight of `RESTING` that the checkpoint does not have, with which what the checkpoint tells stays as it is."""
    return np.eye(shape[0]) if name.endswith(".out.weight") else np.zeros(shape)
