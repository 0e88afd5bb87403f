"""Weights and encoders of others: by the names of their checkpoints, at full shape where memory allows."""

from __future__ import annotations

import dataclasses
import pickle
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.selection.model.config import ClipQuery, Dinov2Query, PaperPatches, SelectionModel, SiglipQuery, Uni3d
from tasks.selection.model.foreign import begin_with_foreign, checkpoint, matched
from tasks.weights import to_safetensors

torch = pytest.importorskip("torch")

PLAIN = {"query_points": False, "query_evidence": False, "residuals": False, "extents": False, "relative": False, "frame": "canonical"}
PAPER = SelectionModel(PaperPatches(), **PLAIN)


def ulip2_shapes() -> dict[str, tuple[int, ...]]:
    """Names and shapes of ULIP-2's point encoder, written out from specs C.2."""
    shapes: dict[str, tuple[int, ...]] = {"logit_scale": (), "pc_projection": (768, 1280)}
    encoder = {
        "encoder.first_conv.0.weight": (128, 6, 1),
        "encoder.first_conv.3.weight": (256, 128, 1),
        "encoder.second_conv.0.weight": (512, 512, 1),
        "encoder.second_conv.3.weight": (256, 512, 1),
        "reduce_dim.weight": (384, 256),
        "pos_embed.0.weight": (128, 3),
        "pos_embed.2.weight": (384, 128),
        "norm.weight": (384,),
        "encoder.first_conv.1.weight": (128,),
        "encoder.second_conv.1.weight": (512,),
    }
    for block in range(18):
        name = f"blocks.blocks.{block}"
        encoder |= {f"{name}.norm1.weight": (384,), f"{name}.norm2.weight": (384,), f"{name}.attn.proj.weight": (384, 384)}
        encoder |= {f"{name}.mlp.fc1.weight": (1536, 384), f"{name}.mlp.fc2.weight": (384, 1536)}
    encoder |= {name.replace("weight", "bias"): shape[:1] for name, shape in encoder.items()}
    encoder |= {f"blocks.blocks.{block}.attn.qkv.weight": (1152, 384) for block in range(18)}
    for name, size in (("encoder.first_conv.1", 128), ("encoder.second_conv.1", 512)):
        encoder |= {f"{name}.running_mean": (size,), f"{name}.running_var": (size,), f"{name}.num_batches_tracked": ()}
    encoder |= {"cls_token": (1, 1, 384), "cls_pos": (1, 1, 384)}
    return shapes | {f"point_encoder.{name}": shape for name, shape in encoder.items()}


def drawn(shapes: dict[str, tuple[int, ...]]) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return {
        name: torch.tensor(3) if name.endswith("tracked") else torch.randn(shape, generator=generator) for name, shape in shapes.items()
    }


@pytest.fixture(scope="module")
def paper():
    from tasks.selection.model.networks.selector import Selector

    return Selector(PAPER)


def test_the_paper_has_the_names_and_shapes_of_ulip2_and_33_million_weights(paper) -> None:
    own = {name: tuple(values.shape) for name, values in paper.state_dict().items() if name.startswith(("point_encoder", "pc_", "logit"))}
    assert own == ulip2_shapes()
    assert 32e6 < sum(p.numel() for p in paper.point_encoder.parameters()) + paper.pc_projection.numel() < 34e6


@pytest.mark.parametrize("kind", ["pt", "safetensors"])
def test_a_checkpoint_of_ulip2_is_taken_whole_and_what_is_surplus_is_reported(paper, tmp_path: Path, kind: str) -> None:
    weights = drawn(ulip2_shapes())
    named = {f"module.{name}": values for name, values in weights.items()} | {"module.open_clip_model.positional_embedding": torch.zeros(2)}
    path = tmp_path / f"ulip.{kind}"
    if kind == "pt":
        torch.save({"epoch": 3, "state_dict": named}, path)
    else:
        path.write_bytes(to_safetensors({name: values.numpy() for name, values in named.items()}))
    note = begin_with_foreign(paper, str(path))
    assert all(torch.equal(paper.state_dict()[name], values) for name, values in weights.items())
    assert note == f"{len(weights)} weights from ulip.{kind}; 1 surplus: open_clip_model.positional_embedding"


def test_too_few_weights_are_an_error_that_names_file_and_keys(paper) -> None:
    wanted = {name: tuple(values.shape) for name, values in paper.state_dict().items()}
    weights = {name: values.numpy() for name, values in drawn(ulip2_shapes()).items()}
    few = {name: values for name, values in weights.items() if not name.startswith("point_encoder.blocks.blocks.17")}
    assert matched(few | {"point_encoder.blocks.blocks.17.norm1.bias": np.zeros(384)}, wanted, "x").missing
    fewer = {name: values for name, values in few.items() if "blocks.16" not in name}
    with pytest.raises(InputError, match=r"^x: point_encoder.blocks.blocks.16.attn.proj.bias: has 90% of the encoder's weights"):
        matched(fewer, wanted, "x")
    odd = {name: np.zeros(5) if "fc1" in name else values for name, values in weights.items()}
    with pytest.raises(InputError, match=r"fc1"):
        matched(odd, wanted, "x")


def test_a_file_that_could_run_code_is_refused(tmp_path: Path) -> None:
    class Evil:
        def __reduce__(self):
            return (Path(tmp_path / "ran").touch, ())

    (tmp_path / "evil.pt").write_bytes(pickle.dumps({"state_dict": Evil()}))
    torch.save({"state_dict": Evil()}, tmp_path / "evil2.pt")
    for name in ("evil.pt", "evil2.pt"):
        with pytest.raises(InputError, match=r"evil2?.pt: : ?is no checkpoint|is no checkpoint"):
            checkpoint(tmp_path / name)
    assert not (tmp_path / "ran").exists()


def test_uni3d_has_its_names_at_full_shape() -> None:
    from tasks.selection.model.networks.selector import Selector

    with torch.device("meta"):
        network = Selector(dataclasses.replace(PAPER, architecture=Uni3d()))
    shapes = {name: tuple(values.shape) for name, values in network.state_dict().items() if name.startswith("point_encoder.")}
    wanted = {
        "encoder.first_conv.0.weight": (128, 6, 1),
        "encoder.second_conv.3.weight": (512, 512, 1),
        "encoder2trans.weight": (1408, 512),
        "trans2embed.weight": (1024, 1408),
        "cls_token": (1, 1, 1408),
        "cls_pos": (1, 1, 1408),
        "pos_embed.2.weight": (1408, 128),
        "visual.blocks.39.attn.qkv.weight": (4224, 1408),
        "visual.blocks.39.attn.q_bias": (1408,),
        "visual.blocks.0.attn.v_bias": (1408,),
        "visual.blocks.0.mlp.fc1.weight": (6144, 1408),
        "visual.blocks.0.norm2.bias": (1408,),
        "visual.fc_norm.weight": (1408,),
    }
    assert {name: shapes[f"point_encoder.{name}"] for name in wanted} == wanted
    assert 0.95e9 < sum(p.numel() for p in network.point_encoder.parameters()) < 1.1e9
    arrays = {name: np.broadcast_to(np.float32(0), shape) for name, shape in shapes.items()}
    found = matched(arrays | {"logit_scale": np.float32(4)}, {name: tuple(v.shape) for name, v in network.state_dict().items()}, "uni3d")
    assert (found.missing, found.surplus, found.wrong) == ((), (), ())


def saved_pair(folder: Path, kind: str) -> None:
    """A tiny CLIP or SigLIP with random weights, and a tokenizer of letters."""
    import transformers
    from tokenizers import Tokenizer, models, pre_tokenizers

    words = {word: i for i, word in enumerate(["<pad>", "<unk>", "<end>", *"abcdefghijklmnopqrstuvwxyz."])}
    letters = Tokenizer(models.WordLevel(words, unk_token="<unk>"))
    letters.pre_tokenizer = pre_tokenizers.Split("", "isolated")
    transformers.PreTrainedTokenizerFast(tokenizer_object=letters, pad_token="<pad>", unk_token="<unk>", eos_token="<end>").save_pretrained(
        folder
    )
    sizes = {"hidden_size": 16, "intermediate_size": 24, "num_hidden_layers": 2, "num_attention_heads": 2}
    text = {**sizes, "vocab_size": len(words), "max_position_embeddings": 16}
    vision = {**sizes, "image_size": 32, "patch_size": 8}
    torch.manual_seed(0)
    if kind == "clip":
        ends = {"eos_token_id": 2, "bos_token_id": 1, "pad_token_id": 0}
        transformers.CLIPModel(
            transformers.CLIPConfig(text_config={**text, **ends}, vision_config=vision, projection_dim=12)
        ).save_pretrained(folder)
    else:
        transformers.SiglipModel(
            transformers.SiglipConfig(text_config={**text, "projection_size": 16}, vision_config=vision)
        ).save_pretrained(folder)


def test_a_tokenizer_may_run_no_code_of_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    transformers = pytest.importorskip("transformers")
    from tasks.selection.model import frozen

    told: list[dict[str, object]] = []
    sizes = SimpleNamespace(vision_config=SimpleNamespace(image_size=8), projection_dim=4)
    monkeypatch.setattr(frozen.encoders, "_model_in", lambda *_: SimpleNamespace(config=sizes))
    monkeypatch.setattr(transformers.AutoTokenizer, "from_pretrained", lambda _, **given: told.append(given))
    frozen.PairEncoder("clip", tmp_path)
    assert told == [{"local_files_only": True, "trust_remote_code": False}]


@pytest.mark.whole
@pytest.mark.parametrize("kind", ["clip", "siglip", "dinov2"])
def test_frozen_encoders_see_and_are_asked_as_transformers_does(tmp_path: Path, kind: str) -> None:
    import transformers

    from tasks.selection.model.frozen import seen_by_frozen, widths_of
    from tasks.selection.model.inference import load
    from tasks.selection.model.networks.selector import Selector
    from tasks.selection.model.scoring import TorchScorer
    from tests.tasks.selection.model.shapes import toy
    from tests.tasks.selection.model.test_inference import SMALL

    if kind == "dinov2":
        sizes = {"hidden_size": 16, "num_hidden_layers": 2, "num_attention_heads": 2, "image_size": 28, "patch_size": 14}
        torch.manual_seed(0)
        transformers.Dinov2Model(transformers.Dinov2Config(**sizes)).save_pretrained(tmp_path)
        config = SelectionModel(SMALL, image=Dinov2Query(str(tmp_path)))
    else:
        saved_pair(tmp_path, kind)
        query = ClipQuery(str(tmp_path)) if kind == "clip" else SiglipQuery(str(tmp_path))
        config = SelectionModel(SMALL, image=query, text=query)
    examples, clouds = toy(2, 0, points=64)
    scanned = examples[1].scanned
    memory: dict[str, bytes] = {}
    seen = seen_by_frozen(scanned, config, memory)
    again = seen_by_frozen(scanned, config, memory)
    assert np.array_equal(seen.image_vector, again.image_vector)
    widths = widths_of(config)
    assert seen.image_vector.shape == (widths[0],)
    assert np.isclose(np.linalg.norm(seen.image_vector), 1.0)
    if kind != "dinov2":
        tokenizer = transformers.AutoTokenizer.from_pretrained(tmp_path)
        model = (transformers.CLIPModel if kind == "clip" else transformers.SiglipModel).from_pretrained(tmp_path).eval()
        text = f"A photo of a {scanned.category}."
        tokens = tokenizer([text], padding=True if kind == "clip" else "max_length", truncation=True, max_length=16, return_tensors="pt")
        mask = {"attention_mask": tokens["attention_mask"]} if kind == "clip" else {}
        with torch.no_grad():
            expected = model.get_text_features(input_ids=tokens["input_ids"], **mask)
        expected = getattr(expected, "pooler_output", expected)[0]
        assert torch.allclose(torch.from_numpy(seen.text_vector), expected / expected.norm(), atol=1e-6)
    torch.manual_seed(1)
    network = Selector(config, image_width=widths[0], text_width=widths[1]).eval()
    weights = to_safetensors({name: values.numpy() for name, values in network.state_dict().items()})
    scorer = load(weights, config)
    assert isinstance(scorer, TorchScorer)
    scores = scorer.score(scanned, examples[1].contenders(clouds))
    darker = dataclasses.replace(scanned, image=(scanned.image * 0.3).astype(np.uint8))
    assert not np.allclose(scores, scorer.score(darker, examples[1].contenders(clouds)), atol=1e-6)
    missing = scorer.score(dataclasses.replace(scanned, image=None), examples[1].contenders(clouds))
    assert np.isfinite(missing).all()
