"""Methods with foreign weights, on small models of the same classes that were drawn at random and saved to a folder."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.geometry.transforms import yaw_pose
from tasks.selection import SelectionConfig
from tasks.selection.evidence import Evidence, InstanceQuery, gather
from tasks.selection.methods import acdc, clip, encoders
from tasks.selection.methods.acdc import AcdcScores
from tasks.selection.methods.clip import Clip
from tasks.selection.methods.encoders import clip_in, dino_in, remembered, weights_digest
from tasks.selection.methods.pictures import parts_of
from tasks.selection.model import frozen
from tasks.selection.model.config import ClipQuery
from tasks.stage import Context
from tasks.views.crops import filling
from tasks.views.pictures import around
from tests.samples import sample
from tests.tasks.selection.rooms import RED, SCENE, Room, cabinet, chair, photographed, scan, table

torch = pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")

pytestmark = pytest.mark.whole


@pytest.fixture(scope="module")
def clip_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A CLIP of 2 layers with a tokenizer of letters."""
    from transformers import CLIPConfig, CLIPModel, CLIPTokenizer

    folder = tmp_path_factory.mktemp("clip")
    letters = [chr(code) for code in range(33, 127)]
    words = {token: index for index, token in enumerate([*letters, *(f"{c}</w>" for c in letters), "<|startoftext|>", "<|endoftext|>"])}
    (folder / "vocab.json").write_text(json.dumps(words))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    last = len(words) - 1
    torch.manual_seed(0)
    small = {"hidden_size": 32, "intermediate_size": 64, "num_hidden_layers": 2, "num_attention_heads": 2}
    model = CLIPModel(
        CLIPConfig(
            text_config={**small, "vocab_size": len(words), "max_position_embeddings": 40, "bos_token_id": last - 1, "eos_token_id": last},
            vision_config={**small, "image_size": 32, "patch_size": 8},
            projection_dim=16,
        )
    )
    model.save_pretrained(folder)
    CLIPTokenizer(str(folder / "vocab.json"), str(folder / "merges.txt")).save_pretrained(folder)
    return folder


@pytest.fixture(scope="module")
def dino_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from transformers import Dinov2Config, Dinov2Model

    folder = tmp_path_factory.mktemp("dino")
    torch.manual_seed(1)
    Dinov2Model(
        Dinov2Config(hidden_size=24, num_hidden_layers=2, num_attention_heads=2, mlp_ratio=2, image_size=56, patch_size=14)
    ).save_pretrained(folder)
    return folder


@pytest.fixture(scope="module")
def room() -> Room:
    made, pose = Room(), yaw_pose(0.4)
    points, colors = scan(chair(RED), pose, (1, 1, 1), np.random.default_rng(0))
    instance = made.instance(points, colors, 0.4, category="chair")
    for slot, (name, parts) in enumerate((("table", table()), ("chair", chair(RED)), ("cabinet", cabinet())), start=1):
        made.candidate(instance, slot, made.asset(parts, name))
    photographed(made, instance, chair(RED), pose, (2.4, 1.3, 1.6))
    return made


def evidence(room: Room) -> tuple[InstanceQuery, list[Evidence]]:
    context = Context(SCENE, "selection", 0, room.blobs)
    gathered = gather(
        room.instances, room.candidates, list(room.assets.values()), context, SelectionConfig(), [], captions=room.captions,
        frames=room.frames, masks=room.masks,
    )  # fmt: skip
    return next(iter(gathered))


def test_clip_scores_by_cosines_of_its_own_vectors(room: Room, clip_folder: Path) -> None:
    """Held against the model as transformers runs it whole, on the same pictures and text."""
    from transformers import CLIPModel, CLIPTokenizer

    query, candidates = evidence(room)
    config = Clip(weights=str(clip_folder))
    scores = clip.score(query, candidates, config, None)
    model = CLIPModel.from_pretrained(clip_folder).eval()
    tokens = CLIPTokenizer.from_pretrained(clip_folder)(["A photo of a chair."], return_tensors="pt")
    mean, std = (np.array(v).reshape(3, 1, 1) for v in ((0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)))
    logits = []
    for each in candidates:
        pictures = around(parts_of(each.asset, room.blobs), 4, (0.35,), 32)
        pixels = torch.tensor(np.stack([(p.transpose(2, 0, 1) / 255 - mean) / std for p in pictures]), dtype=torch.float32)
        with torch.no_grad():
            whole = model(pixel_values=pixels, **tokens)
        mean_vector = whole.image_embeds.numpy().astype(float).mean(axis=0)
        cosine = mean_vector @ whole.text_embeds.numpy()[0] / np.linalg.norm(mean_vector)
        logits.append(float(model.logit_scale.exp().detach()) * cosine)
    expected = np.exp(np.array(logits) - max(logits))
    assert scores == pytest.approx(expected / expected.sum(), abs=1e-4)


def test_the_caption_is_asked_for_where_there_is_one(room: Room, clip_folder: Path) -> None:
    from schemas.captions import Caption

    query, candidates = evidence(room)
    described = dataclasses.replace(query, caption=sample(Caption, scene_id=SCENE, instance_id="0000", sentence="A red wooden chair."))
    assert clip.text_of(query, "caption") == "A photo of a chair."
    assert clip.text_of(described, "caption") == "A red wooden chair."
    assert clip.text_of(described, "category") == "A photo of a chair."
    scores = [clip.score(described, candidates, Clip(weights=str(clip_folder), text=text), None) for text in ("caption", "category")]
    assert not np.allclose(*scores)


def test_rows_name_the_weights_and_are_the_same_again(room: Room, clip_folder: Path, dino_folder: Path) -> None:
    for config in (Clip(weights=str(clip_folder)), AcdcScores(weights=str(dino_folder), yaws=2)):
        rows, degradations = room.select(SelectionConfig(provider=config))
        assert not degradations
        assert {row.provider for row in rows} == {config.kind}
        assert {row.provider_version for row in rows} == {f"1:{weights_digest(config.weights)[:12]}"}
        context = Context(SCENE, "selection", 0, room.blobs)
        first, _ = room.select(SelectionConfig(provider=config), context=context)
        again, _ = room.select(SelectionConfig(provider=config), context=context)
        assert first == again == rows, "vectors out of the cache are those that were put there"


def test_acdc_finds_the_snapshot_that_is_the_crop(room: Room, dino_folder: Path) -> None:
    """A crop that is one of a candidate's snapshots is nearest to it, by the model as transformers runs it whole."""
    from transformers import Dinov2Model

    query, candidates = evidence(room)
    config = AcdcScores(weights=str(dino_folder), yaws=4)
    snapshots = {each.asset.asset_id: around(parts_of(each.asset, room.blobs), 4, (0.35,), 224) for each in candidates}
    model = Dinov2Model.from_pretrained(dino_folder).eval()
    mean, std = (np.array(v).reshape(3, 1, 1) for v in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))

    def patches(pictures: np.ndarray) -> np.ndarray:
        pixels = torch.tensor(np.stack([(p.transpose(2, 0, 1) / 255 - mean) / std for p in pictures]), dtype=torch.float32)
        with torch.no_grad():
            vectors = model(pixel_values=pixels).last_hidden_state[:, 1:].numpy().astype(float)
        return vectors / np.linalg.norm(vectors, axis=2, keepdims=True)

    for truth, each in enumerate(candidates):
        picture = snapshots[each.asset.asset_id][2]
        asked = dataclasses.replace(query)
        object.__setattr__(asked, "crop", _crop(picture))
        scores = acdc.score(asked, candidates, config, None)
        assert int(np.argmax(scores)) == truth
        assert scores[truth] == pytest.approx(1.0, abs=1e-3)
        own = patches(filling(picture, np.ones(picture.shape[:2], dtype=bool), 224)[None])[0]
        for other, score in zip(candidates, scores, strict=True):
            best = max(float((own * shot).sum(axis=1).mean()) for shot in patches(snapshots[other.asset.asset_id]))
            assert score == pytest.approx(0.5 + 0.5 * (0.5 + 0.5 * best), abs=2e-3)


def _crop(picture: np.ndarray):
    from tasks.views.crops import Crop

    return Crop(picture)


def test_categories_that_clip_did_not_choose_come_last(room: Room, clip_folder: Path, dino_folder: Path) -> None:
    query, candidates = evidence(room)
    config = AcdcScores(weights=str(dino_folder), clip=str(clip_folder), categories=1, yaws=2)
    chosen = acdc.likely_categories("chair", ["table", "chair", "cabinet"], config)
    assert chosen == {"chair"}, "the same text has the cosine 1"
    scores = acdc.score(query, candidates, config, None)
    assert scores[1] >= 0.5 >= max(scores[0], scores[2])
    assert acdc.label(config, None) == f"{weights_digest(str(dino_folder))[:12]}+{weights_digest(str(clip_folder))[:12]}"
    assert acdc.likely_categories("chair", ["table", "chair"], dataclasses.replace(config, clip="")) == {"table", "chair"}


def test_folders_that_cannot_be_used_are_refused_by_name(tmp_path: Path, clip_folder: Path, dino_folder: Path) -> None:
    with pytest.raises(InputError, match="names no folder"):
        clip_in("")
    with pytest.raises(InputError, match=r"holds no \*\.safetensors"):
        clip_in(str(tmp_path))
    (tmp_path / "pytorch_model.bin").write_bytes(b"could run code")
    with pytest.raises(InputError, match=r"holds no \*\.safetensors"):
        dino_in(str(tmp_path))
    with pytest.raises(InputError, match="holds no CLIPModel"):
        clip_in(str(dino_folder))
    lost = tmp_path / "lost"
    lost.mkdir()
    for file in dino_folder.iterdir():
        (lost / file.name).write_bytes(file.read_bytes())
    from safetensors.torch import load_file, save_file

    weights = load_file(lost / "model.safetensors")
    weights.pop(sorted(weights)[0])
    save_file(weights, lost / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(InputError, match="lacks 1 of its weights"):
        dino_in(str(lost))


@pytest.mark.parametrize("gone", ["torch", "transformers"])
def test_without_the_packages_a_line_says_how_they_get_there(
    clip_folder: Path, dino_folder: Path, gone: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before anything is aligned, and wherever an encoder is opened."""
    encoders._clip.cache_clear()
    encoders._dino.cache_clear()
    frozen._pair.cache_clear()
    monkeypatch.setitem(sys.modules, gone, None)
    weights = str(clip_folder)
    for refuse in (
        lambda: Room().select(SelectionConfig(provider=Clip(weights=weights))),
        lambda: Room().select(SelectionConfig(provider=AcdcScores(weights=str(dino_folder)))),
        lambda: clip_in(weights),
        lambda: dino_in(str(dino_folder)),
        lambda: frozen.pair_in(ClipQuery(weights)),
    ):
        with pytest.raises(InputError, match=rf"selection: {gone}: is not installed; pip install 'metascenes\[encoders\]'"):
            refuse()


def test_other_weights_in_the_same_folder_are_others(tmp_path: Path, dino_folder: Path) -> None:
    for file in dino_folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    before = weights_digest(str(tmp_path))
    assert before == weights_digest(str(dino_folder))
    raw = bytearray((tmp_path / "model.safetensors").read_bytes())
    raw[-1] ^= 1
    (tmp_path / "model.safetensors").write_bytes(raw)
    assert weights_digest(str(tmp_path)) != before


def test_vectors_are_remembered_to_the_last_bit() -> None:
    memory: dict[str, bytes] = {}
    vectors = np.random.default_rng(0).normal(size=(3, 4, 5)).astype(np.float32)
    for half in (False, True):
        first = remembered(memory, f"{half}", lambda: vectors, half)
        again = remembered(memory, f"{half}", lambda: pytest.fail("it is known"), half)
        assert first.shape == (3, 4, 5)
        assert (first == again).all()
        assert np.allclose(first, vectors, atol=2e-3 if half else 0)
