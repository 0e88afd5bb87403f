"""Weights as safetensors: the same as the format's own library reads and writes, and nothing else gets through."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of

from schemas.errors import InputError
from tasks.weights import from_safetensors, to_safetensors

library = pytest.importorskip("safetensors.numpy")

DTYPES = ["f4", "f8", "f2", "i8", "i4", "i2", "i1", "u1", "u2", "u4", "u8", "?"]
NAMED = st.dictionaries(
    st.text(st.characters(codec="utf-8", exclude_characters="\x00"), min_size=1, max_size=8).filter(lambda name: name != "__metadata__"),
    st.sampled_from(DTYPES).flatmap(lambda kind: arrays_of.arrays(kind, arrays_of.array_shapes(min_dims=0, max_dims=3, min_side=0))),
    max_size=4,
)


def same(one: dict[str, Any], two: dict[str, Any]) -> bool:
    return one.keys() == two.keys() and all(
        one[name].dtype == two[name].dtype and one[name].shape == two[name].shape and one[name].tobytes() == two[name].tobytes()
        for name in one
    )


@settings(max_examples=60, deadline=None)
@given(NAMED)
def test_the_formats_own_library_reads_and_writes_the_same(arrays: dict[str, Any]) -> None:
    data = to_safetensors(arrays)
    assert same(library.load(data), arrays)
    assert same(from_safetensors(data), arrays)
    assert same(from_safetensors(library.save(arrays)), arrays)
    assert to_safetensors(dict(reversed(arrays.items()))) == data


def test_arrays_in_any_layout_are_written_as_they_read() -> None:
    array = np.arange(24, dtype=">f4").reshape(2, 3, 4)
    for given_array in (array, array.T, array[:, ::-1]):
        assert np.array_equal(from_safetensors(to_safetensors({"a": given_array}))["a"], given_array)
    with pytest.raises(ValueError, match="a: arrays of complex128"):
        to_safetensors({"a": np.zeros(2, complex)})


def test_bfloat16_is_read_as_float32() -> None:
    torch = pytest.importorskip("torch")
    from safetensors.torch import save

    tensor = torch.randn(5, 3).bfloat16()
    assert np.array_equal(from_safetensors(save({"a": tensor}))["a"], tensor.float().numpy())


def test_what_is_cut_off_anywhere_is_refused() -> None:
    data = to_safetensors({"a": np.ones((2, 2), np.float32), "b": np.zeros(3, np.int64)})
    for length in range(len(data)):
        with pytest.raises(InputError):
            from_safetensors(data[:length])
    with pytest.raises(InputError, match="belong to no array"):
        from_safetensors(data + b"\x00")


def with_header(header: Any, body: bytes = bytes(8)) -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + body


ENTRY = {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]}


@pytest.mark.parametrize(
    ("header", "problem"),
    [
        (b"\x80\x04\x95", "is no JSON"),
        (b"[" * 60_000, "is no JSON"),
        ([], "is no table"),
        ({"a": {**ENTRY, "shape": [3]}}, "do not fit"),
        ({"a": {**ENTRY, "shape": [-2]}}, "must have dtype"),
        ({"a": {**ENTRY, "shape": [2**40, 2**40]}}, "must have dtype"),
        ({"a": {**ENTRY, "shape": [True, 2]}}, "must have dtype"),
        ({"a": {**ENTRY, "dtype": "OBJECT"}}, "must have dtype"),
        ({"a": {**ENTRY, "dtype": ["F32"]}}, "must have dtype"),
        ({"a": {**ENTRY, "data_offsets": [0, 800]}}, "do not fit"),
        ({"a": ENTRY, "b": ENTRY}, "do not fit"),
        ({"a": {"dtype": "F32", "shape": [1], "data_offsets": [4, 8]}}, "do not fit"),
        ({}, "belong to no array"),
        ({"a": {**ENTRY, "more": 1}}, "must have dtype"),
    ],
)
def test_headers_that_do_not_fit_are_refused(header: Any, problem: str) -> None:
    with pytest.raises(InputError, match=problem) as refused:
        from_safetensors(with_header(header), "model/weights.safetensors")
    assert str(refused.value).startswith("model/weights.safetensors")
    assert "\n" not in str(refused.value)


def test_a_header_longer_than_the_file_is_refused_before_it_is_read() -> None:
    with pytest.raises(InputError, match="cut off"):
        from_safetensors((2**62).to_bytes(8, "little") + bytes(100))
    assert from_safetensors(with_header({"__metadata__": {"format": "pt"}, "a": ENTRY}))["a"].tolist() == [0, 0]
