"""Layouts as arrays and back, and what a model's weights say of it."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.synthesis.layout import Large, Layout
from tasks.synthesis.model.encoding import BOUNDS, BOX, VOCABULARY, Heights, encoding_in, encoding_of
from tasks.weights import from_safetensors, to_safetensors
from tests.tasks.synthesis.drawn_layouts import layouts

LEARNED = layouts(40)
ENCODING = encoding_of(LEARNED, ["kettle"])


def same(one: Layout, other: Layout) -> None:
    assert (one.large, one.categories) == (other.large, other.categories)
    np.testing.assert_allclose(one.centers, other.centers, atol=1e-6)
    np.testing.assert_allclose(one.sizes, other.sizes, atol=1e-6)
    np.testing.assert_allclose(np.exp(1j * one.yaws), np.exp(1j * other.yaws), atol=1e-6)


@given(st.integers(0, 2**32 - 1), st.integers(0, 3), st.sampled_from(["middles", "bottoms"]))
def test_what_was_encoded_comes_back(seed: int, spare: int, heights: Heights) -> None:
    given_ = layouts(5, seed)
    encoding = encoding_of(given_, heights=heights)
    for layout in given_:
        vectors = encoding.vectors(layout, len(layout) + 1 + spare)
        assert np.abs(vectors).max() <= 1.0 + 1e-6
        same(encoding.layout(vectors, layout.large), layout)
        order = np.random.default_rng(seed).permutation(len(layout) + spare) + 1
        shuffled = encoding.layout(vectors[[0, *order]], layout.large)
        assert sorted(zip(shuffled.categories, shuffled.yaws.round(4), strict=True)) == sorted(
            zip(layout.categories, layout.yaws.round(4), strict=True)
        )


def test_an_object_has_the_numbers_of_the_specs_in_their_order() -> None:
    layout = LEARNED[0]
    vectors = ENCODING.vectors(layout, 8)
    assert vectors.shape == (8, 3 + 3 + 2 + len(ENCODING.classes) + 1)
    np.testing.assert_allclose(
        vectors[1, 3:6], 2 * (layout.sizes[0] / 2 - ENCODING.low[3:]) / (ENCODING.high - ENCODING.low)[3:] - 1, rtol=1e-5
    )
    np.testing.assert_allclose(vectors[1, 6:8], [np.cos(layout.yaws[0]), np.sin(layout.yaws[0])], rtol=1e-6)
    one_hot = np.full(len(ENCODING.classes) + 1, -1.0)
    one_hot[ENCODING.classes.index(layout.categories[0])] = 1.0
    np.testing.assert_array_equal(vectors[1, BOX:], one_hot)
    np.testing.assert_array_equal(vectors[-1], [0.0] * 8 + [-1.0] * len(ENCODING.classes) + [1.0])
    np.testing.assert_array_equal(vectors[0, [0, 1, 2, 6, 7]], [0, 0, 0, 1, 0])
    assert ENCODING.classes[vectors[0, BOX:].argmax()] == layout.large.category


def test_bottoms_are_told_over_the_top_of_the_large_object_whatever_its_height() -> None:
    encoding = encoding_of(LEARNED, heights="bottoms")
    layout = next(layout for layout in LEARNED if len(layout) > 2)
    lift = np.array([0.0, 0.0, 0.25])
    depth, width, height = layout.large.size
    higher = Layout(
        Large(layout.large.category, (depth, width, height + 0.25)), layout.categories, layout.centers + lift, layout.sizes, layout.yaws
    )
    np.testing.assert_allclose(encoding.vectors(higher, 8)[1:], encoding.vectors(layout, 8)[1:], atol=1e-6)
    bottoms = layout.centers[:, 2] - 0.5 * layout.sizes[:, 2] - height
    wanted = 2 * (bottoms - encoding.low[2]) / (encoding.high - encoding.low)[2] - 1
    np.testing.assert_allclose(encoding.vectors(layout, 8)[1 : 1 + len(layout), 2], wanted, atol=1e-6)
    middles = encoding_of(LEARNED, heights="middles")
    assert np.abs(middles.vectors(higher, 8)[1:, 2] - middles.vectors(layout, 8)[1:, 2]).max() > 0.01


def test_small_objects_are_never_what_only_large_ones_are() -> None:
    vectors = ENCODING.vectors(LEARNED[0], 4)
    vectors[1, BOX + ENCODING.classes.index("desk")] = 9.0
    vectors[2, BOX + ENCODING.classes.index("kettle")] = 9.0
    assert not {"desk", "kettle"} & {*ENCODING.layout(vectors, LEARNED[0].large).categories}


def test_what_is_outside_of_what_was_learned() -> None:
    desk = dataclasses.replace(LEARNED[0].large, size=(9.0, 0.01, 9.0), room_type="cellar", category="desk")
    np.testing.assert_array_equal(ENCODING.large_vector(desk)[3:6], [1, -1, 1])
    assert ENCODING.condition(desk)[1] == 0
    assert ENCODING.rooms[0] == "unknown"
    with pytest.raises(InputError, match="'bed' is no large object that the model knows; it knows desk, table"):
        ENCODING.condition(Large("bed", (1, 1, 1)))
    odd = Layout(LEARNED[0].large, ("sword",), np.zeros((1, 3)), np.ones((1, 3)), np.zeros(1))
    with pytest.raises(InputError, match="the model knows no sword"):
        ENCODING.vectors(odd, 3)
    with pytest.raises(InputError, match="no small object"):
        encoding_of([])


@pytest.mark.parametrize("heights", ["middles", "bottoms"])
def test_a_models_weights_say_how_it_encodes(heights: Heights) -> None:
    encoding = encoding_of(LEARNED, ["kettle"], heights)
    arrays = from_safetensors(to_safetensors(encoding.arrays()))
    read = encoding_in(arrays)
    for name in ("classes", "small", "large", "rooms", "heights"):
        assert getattr(read, name) == getattr(encoding, name)
    for name in ("low", "high", "large_low", "large_high"):
        np.testing.assert_array_equal(getattr(read, name), getattr(encoding, name))


def text(**changes: object) -> np.ndarray:
    words = json.loads(ENCODING.arrays()[VOCABULARY].tobytes()) | changes
    return np.frombuffer(json.dumps(words).encode(), dtype=np.uint8)


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({VOCABULARY: None}, VOCABULARY),
        ({BOUNDS: None}, BOUNDS),
        ({VOCABULARY: np.frombuffer(b"{", dtype=np.uint8)}, VOCABULARY),
        ({VOCABULARY: np.frombuffer(b"[" * 9000, dtype=np.uint8)}, VOCABULARY),
        ({VOCABULARY: np.frombuffer(b"[]", dtype=np.uint8)}, VOCABULARY),
        ({VOCABULARY: text(classes=[1, 2])}, VOCABULARY),
        ({VOCABULARY: text(small=["mug", "mug"])}, VOCABULARY),
        ({VOCABULARY: text(small=["sword"])}, VOCABULARY),
        ({VOCABULARY: text(rooms=["office"])}, VOCABULARY),
        ({VOCABULARY: text(large=[])}, VOCABULARY),
        ({VOCABULARY: text(heights="feet")}, VOCABULARY),
        ({BOUNDS: np.zeros((4, 6))}, BOUNDS),
        ({BOUNDS: np.full((4, 6), np.nan)}, BOUNDS),
        ({BOUNDS: np.zeros(3)}, BOUNDS),
    ],
)
def test_weights_that_do_not_say_it_are_refused(changes: dict, name: str) -> None:
    arrays = {key: value for key, value in {**ENCODING.arrays(), **changes}.items() if value is not None}
    with pytest.raises(InputError) as error:
        encoding_in(arrays, "some.safetensors")
    assert error.value.field == name
