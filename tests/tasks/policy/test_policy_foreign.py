"""Weights of SPOC by the names in its checkpoints, against a network of these names written from the specs (E.1).

No file of SPOC's was at hand; names are those that its code gives its weights.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.policy.actions import FORWARD, LEFT, RIGHT, START, STOP, UNTOLD
from tasks.policy.model.config import SiglipEyes, SiglipGoal
from tasks.policy.model.foreign import begin_with_foreign, from_spoc, their_names
from tasks.policy.model.shapes import shapes_of
from tasks.weights import to_safetensors
from tests.tasks.policy.policies import TINY, drawn_network

torch = pytest.importorskip("torch")
nn = torch.nn

MODEL = dataclasses.replace(
    TINY, eyes=SiglipEyes(width=12, grid=(2, 3)), goal=SiglipGoal(width=10, tokens=5), feedforward=2048, dropout=0.0
)
THEIRS = {0: FORWARD, 1: RIGHT, 2: LEFT, 4: STOP}
"""Our actions by their places."""


class Spoc(nn.Module):
    """Early fusion and a causal decoder, with the names of SPOC's weights, of tokens of pictures and states of texts."""

    def __init__(self, actions: int) -> None:
        super().__init__()
        width, heads = MODEL.width, MODEL.heads

        def adapter(inside: int) -> Any:
            return nn.Sequential(nn.Linear(inside, width), nn.LayerNorm(width), nn.ReLU())

        outer = nn.Module()
        outer.visual_compressor = nn.Sequential(nn.Conv2d(12, width, 1), nn.ReLU(), nn.Conv2d(width, width, 1), nn.ReLU())
        outer.visual_adapter, outer.text_adapter = adapter(width), adapter(10)
        outer.fusion_xformer = nn.TransformerEncoder(nn.TransformerEncoderLayer(width, heads, batch_first=True, dropout=0.0), 1)
        outer.fusion_token = nn.Parameter(torch.rand(width))
        outer.visual_sensor_token_raw_navigation_camera = nn.Parameter(torch.rand(width))
        outer.visual_sensor_token_raw_manipulation_camera = nn.Parameter(torch.rand(width))
        outer.image_encoder, outer.text_encoder = nn.Linear(2, 2), nn.Linear(2, 2)
        self.visual_encoder: Any = outer
        self.decoder = nn.TransformerDecoder(nn.TransformerDecoderLayer(width, heads, batch_first=True, dropout=0.0), 2)
        self.action_classifier = nn.Linear(width, actions)
        self.last_actions_embed = nn.Embedding(actions + 2, width)
        self.time_encoder = nn.Module()
        self.time_encoder.register_buffer("div_term", 10_000.0 ** (-torch.arange(0, width, 2) / width))

    def forward(self, maps: Any, texts: Any, last: Any, times: Any) -> Any:
        """Logits (b, t, a). maps: Tokens of pictures (b, t, e, rows, columns). texts: States (b, s, e). last, times: (b, t)."""
        outer, (batch, steps) = self.visual_encoder, maps.shape[:2]
        seen = outer.visual_compressor(maps.flatten(0, 1)).flatten(2).transpose(1, 2)
        seen = outer.visual_adapter(seen) + outer.visual_sensor_token_raw_navigation_camera
        text = outer.text_adapter(texts)
        every = [outer.fusion_token.expand(batch * steps, 1, -1), seen, text.repeat_interleave(steps, dim=0)]
        fused = outer.fusion_xformer(torch.cat(every, dim=1))[:, 0].reshape(batch, steps, -1)
        phases = times[..., None] * self.time_encoder.div_term
        waves = torch.stack([phases.sin(), phases.cos()], dim=-1).flatten(-2)
        mask = torch.full((steps, steps), -torch.inf).triu(1)
        return self.action_classifier(self.decoder(fused + self.last_actions_embed(last) + waves, text, tgt_mask=mask))


def theirs(actions: int) -> Any:
    torch.manual_seed(0)
    module = Spoc(actions).eval()
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape))
    return module


@pytest.mark.parametrize(("actions", "prefix"), [(20, "model."), (20, ""), (4, "module.")])
def test_spocs_weights_tell_the_same_here(tmp_path: Path, actions: int, prefix: str) -> None:
    other = theirs(actions)
    file = tmp_path / "spoc.ckpt"
    torch.save({"state_dict": {prefix + name: tensor for name, tensor in other.state_dict().items()}, "epoch": 3}, file)
    module = drawn_network(MODEL)
    note = begin_with_foreign(module, str(file))
    assert note.startswith(f"{len(their_names(shapes_of(MODEL, 1)))} weights from spoc.ckpt; left out: image_encoder, text_encoder, time")
    rng = np.random.default_rng(0)
    batch, steps = 2, 4
    maps = torch.from_numpy(rng.normal(size=(batch, steps, 12, 2, 3)).astype(np.float32))
    last, times = torch.from_numpy(rng.integers(0, UNTOLD + 1, (batch, steps))), torch.arange(steps).expand(batch, -1) + 11
    places = {**{ours: there for there, ours in THEIRS.items()}, START: 20, UNTOLD: 21} if actions == 20 else {i: i for i in range(6)}
    with torch.no_grad():
        expected = other(maps, module.goal.states[[1, 2]], last.apply_(lambda place: places[place]).clone(), times)
        inverse = {there: ours for ours, there in places.items()}
        made = module({
            "pictures": maps.flatten(0, 1).flatten(2).transpose(1, 2), "owner": torch.arange(batch).repeat_interleave(steps),
            "places": torch.arange(batch * steps).reshape(batch, steps), "goals": torch.tensor([1, 2]),
            "last": last.apply_(lambda place: inverse[place]), "times": times,
        })  # fmt: skip
    assert torch.allclose(made, expected[..., [places[action] for action in range(4)]], atol=1e-5)


def test_every_weight_but_the_goals_states_finds_its_place_and_comes_back() -> None:
    shapes = shapes_of(MODEL, 1)
    names = their_names(shapes)
    assert {*shapes} - {*names} == {"goal.states"}
    assert len({*names.values()}) == len(names)
    arrays = {there: np.random.default_rng(0).normal(size=shapes[here]) for here, there in names.items()}
    made, note = from_spoc(arrays, MODEL, "file")
    assert note == "all of them"
    assert {names[here] for here in made} == {*arrays}
    assert all(np.array_equal(arrays[names[here]], array) for here, array in made.items())


def test_files_of_other_networks_are_refused(tmp_path: Path) -> None:
    state = {name: tensor.numpy() for name, tensor in theirs(20).state_dict().items()}
    with pytest.raises(InputError, match="1 of its weights are unknown: bbox"):
        from_spoc({**state, "bbox": np.zeros(2)}, MODEL, "file")
    with pytest.raises(InputError, match=r"are missing: visual_encoder\.fusion_token"):
        from_spoc({name: array for name, array in state.items() if name != "visual_encoder.fusion_token"}, MODEL, "file")
    with pytest.raises(InputError, match="has the shape"):
        from_spoc({**state, "action_classifier.weight": np.zeros((7, 16))}, MODEL, "file")
    with pytest.raises(InputError, match="or take the model `paper`"):
        from_spoc(state, TINY, "file")
    (tmp_path / "x.safetensors").write_bytes(to_safetensors({"a": np.zeros(2)}))
    with pytest.raises(InputError, match="name a checkpoint of SPOC's siglip_base_3"):
        begin_with_foreign(drawn_network(MODEL), str(tmp_path / "x.safetensors"))
