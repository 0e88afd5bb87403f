"""Vectors of pictures and texts, by small models of both kinds that were drawn at random and saved to a folder."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import InputError
from tasks.library.catalog import Catalog
from tasks.library.embeddings import encoder_in
from tasks.library.entry import dumped
from tasks.library.indexing import IndexConfig, index_folder
from tasks.library.search import LibrarySearch
from tests.conftest import made_once
from tests.tasks.library.models import as_glb, chair
from tests.tasks.library.siglip import write_siglip
from tests.tasks.selection.test_foreign_methods import clip_folder

torch = pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")

pytestmark = pytest.mark.whole

__all__ = ["clip_folder"]


@pytest.fixture(scope="session")
def siglip_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a tiny SigLIP."""
    return made_once(tmp_path_factory, "tiny_siglip", write_siglip)


@pytest.fixture(params=["clip_folder", "siglip_folder"])
def weights(request: pytest.FixtureRequest) -> str:
    return str(request.getfixturevalue(request.param))


def test_vectors_are_of_length_one_and_tell_pictures_and_texts_apart(weights: str) -> None:
    encoder = encoder_in(weights)
    pictures = np.random.default_rng(0).integers(0, 256, (3, encoder.side, encoder.side, 3)).astype(np.uint8)
    images, texts = encoder.images(pictures), encoder.texts(["A photo of a chair.", "A photo of a table.", "of " * 100])
    for vectors in (images, texts):
        assert vectors.shape[0] == 3
        assert np.allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-5)
        assert np.linalg.norm(vectors[0] - vectors[1]) > 1e-4
    assert images.shape[1] == texts.shape[1]
    assert np.array_equal(encoder.images(pictures[1:]), images[1:]) or np.allclose(encoder.images(pictures[1:]), images[1:], atol=1e-5)


def test_siglip_is_what_transformers_makes_of_it(siglip_folder: Path) -> None:
    """The model's own features, from pictures prepared by hand."""
    from transformers import SiglipModel

    encoder, model = encoder_in(str(siglip_folder)), SiglipModel.from_pretrained(str(siglip_folder)).eval()
    pictures = np.random.default_rng(1).integers(0, 256, (2, 32, 32, 3)).astype(np.uint8)
    pixels = torch.tensor(pictures.transpose(0, 3, 1, 2) / 127.5 - 1, dtype=torch.float32)
    with torch.no_grad():
        wanted = model(pixel_values=pixels, input_ids=torch.tensor([[2, 3, 4, 5, 6, 8] + [0] * 10]))
    assert np.allclose(encoder.images(pictures), wanted.image_embeds.numpy(), atol=1e-5)
    assert np.allclose(encoder.texts(["A photo of a chair."]), wanted.text_embeds.numpy(), atol=1e-5)


def test_entries_have_vectors_where_a_model_is_named(tmp_path: Path, weights: str) -> None:
    (tmp_path / "a_chair.glb").write_bytes(as_glb(chair()))
    (tmp_path / "b_chair.glb").write_bytes(as_glb(chair(5)))
    config = IndexConfig(views=3, weights=weights)
    index = index_folder(tmp_path, Catalog({}), config, store := {})
    assert all(entry.image_vectors.shape[0] == 3 and len(entry.weights) == 64 for entry in index.entries)
    assert [dumped(entry) for entry in index_folder(tmp_path, Catalog({}), config, store).entries] == [
        dumped(entry) for entry in index.entries
    ]
    assert LibrarySearch.of(index.entries).arrays["views"].shape[:2] == (2, 3)


def test_a_folder_of_another_model_is_refused(tmp_path: Path, siglip_folder: Path) -> None:
    import shutil

    for problem, change in (
        ("is Dinov2Model", lambda folder: (folder / "config.json").write_text(json.dumps({"architectures": ["Dinov2Model"]}))),
        ("is not stated", lambda folder: (folder / "config.json").write_text("[]")),
        ("is no JSON", lambda folder: (folder / "config.json").write_text("{")),
        ("holds no SiglipModel", lambda folder: (folder / "model.safetensors").write_bytes(b"nothing")),
        ("holds no ", lambda folder: (folder / "model.safetensors").unlink()),
    ):
        folder = tmp_path / problem.replace(" ", "_")
        shutil.copytree(siglip_folder, folder)
        change(folder)
        with pytest.raises(InputError, match=problem):
            encoder_in(str(folder))
