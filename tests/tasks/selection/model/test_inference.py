"""Inference without torch, held against torch with random weights of every switch."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.selection.model.batches import predicted
from tasks.selection.model.config import NoQuery, OwnImage, OwnText, PaperPatches, SelectionModel, Small
from tasks.selection.model.inference import Scorer, load
from tasks.selection.model.shapes import shapes_of
from tasks.selection.model.sight import scan_cloud
from tasks.weights import to_safetensors
from tests.conftest import REPOSITORY
from tests.tasks.selection.model.shapes import toy

SMALL = Small(points=48, groups=8, group_size=6, dim=24, depth=2, heads=4, first_widths=(8, 16), second_widths=(16, 24), position_width=8,
              embedding=20, head_width=16)  # fmt: skip
PAPER = PaperPatches(
    points=48, groups=8, group_size=6, dim=24, depth=3, heads=6, first_widths=(8, 16), second_widths=(32, 16), embedding=40
)
FULL = SelectionModel(
    SMALL, image=OwnImage(widths=(4, 6, 8)), text=OwnText(buckets=64, width=8), residual_points=16, residual_widths=(8, 12)
)
SWITCHES = {
    "full": {}, "paper": {"architecture": PAPER}, "no image": {"image": NoQuery()}, "no text": {"text": NoQuery()},
    "no points": {"query_points": False}, "no evidence": {"query_evidence": False}, "no residuals": {"residuals": False},
    "no extents": {"extents": False}, "no quality": {"quality": False}, "not relative": {"relative": False},
    "canonical": {"frame": "canonical"}, "fixed": {"temperature": "fixed"}, "no temperature": {"temperature": "none"},
    "match decides": {"decides": "match"}, "imagenet": {"image_normalization": "imagenet"}, "side": {"image": OwnImage(side=32)},
    "nothing asked": {"image": NoQuery(), "text": NoQuery(), "query_points": False},
}  # fmt: skip


def random_weights(config: SelectionModel, seed: int = 0):
    """A network with random weights, also where training begins with zeros and ones, and the same at half precision as bytes."""
    torch = pytest.importorskip("torch")
    from tasks.selection.model.networks.selector import Selector

    torch.manual_seed(seed)
    network = Selector(config).eval()
    with torch.no_grad():
        for name, values in network.state_dict().items():
            if values.is_floating_point() and values.ndim:
                values.copy_((0.5 + torch.rand_like(values) if name.endswith("var") else values + 0.2 * torch.randn_like(values)).half())
            elif values.is_floating_point():
                values.copy_(values.half())
    state = {
        name: values.numpy().astype("<f2") if values.is_floating_point() else values.numpy()
        for name, values in network.state_dict().items()
    }
    return network, to_safetensors(state)


@pytest.mark.parametrize("switch", SWITCHES)
def test_numpy_scores_as_torch_does(switch: str) -> None:
    config = dataclasses.replace(FULL, **SWITCHES[switch])
    network, weights = random_weights(config)
    scorer = load(weights, config)
    assert isinstance(scorer, Scorer)
    examples, clouds = toy(6, 1, points=64)
    examples[0] = dataclasses.replace(examples[0], candidates=examples[0].candidates[:1])
    for example, expected in zip(examples, predicted(network, examples, clouds), strict=True):
        scores = scorer.score(example.scanned, example.contenders(clouds))
        assert scores.shape == expected.shape == (len(example.candidates),)
        assert np.abs(scores - expected).max() <= 1e-5 * max(1.0, float(np.abs(expected).max()))


def test_the_networks_as_configured_score_alike() -> None:
    config = SelectionModel()
    network, weights = random_weights(config)
    assert sum(p.numel() for p in network.parameters()) <= 2_000_000
    assert len(weights) <= 5_000_000
    examples, clouds = toy(3, 2, points=512)
    for example, expected in zip(examples, predicted(network, examples, clouds), strict=True):
        assert np.abs(load(weights, config).score(example.scanned, example.contenders(clouds)) - expected).max() <= 1e-5 * max(
            1.0, np.abs(expected).max()
        )


@pytest.mark.parametrize("switch", SWITCHES)
def test_shapes_are_those_of_the_network(switch: str) -> None:
    config = dataclasses.replace(FULL, **SWITCHES[switch])
    network, _ = random_weights(config)
    assert {name: tuple(values.shape) for name, values in network.state_dict().items()} == shapes_of(config)


def test_weights_of_another_config_are_refused_by_name() -> None:
    _, weights = random_weights(FULL)
    with pytest.raises(InputError, match=r"^mine: image_encoder.convolutions.0.bias: is unknown"):
        load(weights, dataclasses.replace(FULL, image=NoQuery()), "mine")
    with pytest.raises(InputError, match=r"^mine: size_embedding.bias: is missing"):
        load(random_weights(dataclasses.replace(FULL, extents=False, quality=False))[1], dataclasses.replace(FULL, quality=False), "mine")
    with pytest.raises(InputError, match="has the shape"):
        load(weights, dataclasses.replace(FULL, architecture=dataclasses.replace(SMALL, head_width=17)), "mine")


def test_scoring_loads_no_torch() -> None:
    code = (
        "import sys; from tasks.selection.model.inference import *; from tasks.selection.model.shapes import *;"
        "from tests.tasks.selection.model.shapes import toy; import numpy as np;"
        "c = SelectionModel(); e, clouds = toy(1, 0);"
        "w = {n: np.ones(s, dtype='<f4') for n, s in shapes_of(c).items()};"
        "Scorer(c, folded(w)).score(e[0].scanned, e[0].contenders(clouds)); print('torch' in sys.modules)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=REPOSITORY)
    assert (found.stdout, found.stderr) == ("False\n", "")


def test_names_are_compared_as_torch_compares_them() -> None:
    import torch

    from tasks.selection.model.batches import joined, tensors
    from tasks.selection.model.features import features_of
    from tasks.selection.model.words import tokens_of

    network, weights = random_weights(FULL)
    examples, clouds = toy(1, 3)
    names = ["table", "office chair"]
    batch = tensors(joined([features_of(examples[0].scanned, examples[0].contenders(clouds), FULL)]))
    batch["words"] = torch.from_numpy(np.stack([tokens_of(name, 64, 24) for name in names]))
    with torch.no_grad():
        expected = network(batch)["names"][0].numpy()
    scorer = load(weights, FULL)
    assert isinstance(scorer, Scorer)
    assert (
        np.abs(scorer.named(examples[0].scanned.cloud, examples[0].scanned.extents, names, 24) - expected).max()
        <= 1e-5 * np.abs(expected).max()
    )


def test_clouds_alone_are_scored_without_evidence() -> None:
    config = dataclasses.replace(FULL, query_evidence=False, residuals=False)
    _, weights = random_weights(config)
    scorer = load(weights, config)
    assert isinstance(scorer, Scorer)
    examples, clouds = toy(1, 4, points=64)
    scanned, contenders = examples[0].scanned, examples[0].contenders(clouds)
    points, colors = np.stack([c.cloud.points for c in contenders]), np.stack([c.cloud.colors for c in contenders])
    extents = np.stack([*(c.extents for c in contenders), scanned.extents])
    seen = scanned.cloud.points, scanned.cloud.colors
    made = scorer.scores(points, colors, scanned.image, scanned.category, extents, seen)
    ordered = [dataclasses.replace(c, cloud=scan_cloud(c.cloud.points, c.cloud.colors, config)) for c in contenders]
    whole = dataclasses.replace(scanned, cloud=scan_cloud(*seen, config))
    assert np.abs(made - scorer.score(whole, ordered)).max() <= 1e-4
    order = np.random.default_rng(0).permutation(points.shape[1])
    mixed = scorer.scores(points[:, order], colors[:, order], scanned.image, scanned.category, extents, seen)
    assert np.abs(made - mixed).max() <= 1e-3
