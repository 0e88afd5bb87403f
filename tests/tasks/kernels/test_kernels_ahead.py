"""Kernels that are compiled ahead: their list is of kernels that are there, and types survive being written."""

from __future__ import annotations

import importlib
import inspect

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import typeof, types
from numba.core.types import Type

from tasks.kernels.ahead import Signature, signatures, text_of, type_of
from tasks.optimization.search.arrangement import Arrangement
from tasks.optimization.shapes import Stand

SCALARS = (types.float64, types.float32, types.int64, types.int32, types.uint8, types.int8, types.uint16, types.boolean)
PLAIN = st.one_of(
    st.sampled_from(SCALARS),
    st.just(types.npy_rng),
    st.builds(types.Array, st.sampled_from(SCALARS), st.integers(1, 5), st.sampled_from("CFA"), readonly=st.booleans()),
)


@st.composite
def named(draw: st.DrawFn) -> Type:
    """A named tuple of the optimization, with fields of any types, named tuples among them."""
    own = draw(st.sampled_from((Stand, Arrangement)))
    width = len(own._fields)
    if draw(st.booleans()):
        return types.NamedUniTuple(draw(PLAIN), width, own)
    stand = types.NamedUniTuple(draw(PLAIN), len(Stand._fields), Stand)
    return types.NamedTuple((types.float64, stand, *draw(st.lists(PLAIN, min_size=width - 2, max_size=width - 2))), own)


@given(st.one_of(PLAIN, named()))
def test_a_type_that_is_written_is_read_as_itself(kind: Type) -> None:
    assert type_of(text_of(kind)) == kind


def test_types_are_those_that_numba_finds() -> None:
    held = np.zeros((3, 2))
    held.flags.writeable = False
    for value in (held, held.T, np.zeros(3, np.int32), True, 1.5, 3, np.random.default_rng(0), Stand(*[np.zeros((2, 3))] * 6)):
        assert type_of(text_of(typeof(value))) == typeof(value)


@pytest.mark.parametrize("text", ["", "array(float64, 2d, X)", "nosuch", "Array", "float64[:]"])
def test_a_text_that_names_no_type_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="no type"):
        type_of(text)


def test_a_type_that_has_no_text_is_refused() -> None:
    with pytest.raises(ValueError, match="no t"):
        text_of(types.unicode_type)


@pytest.mark.parametrize("kernel", signatures(), ids=lambda kernel: f"{kernel.maker}-{kernel.name}-{len(str(kernel.types))}")
def test_each_kernel_is_there_and_takes_so_many_arguments(kernel: Signature) -> None:
    place, _, maker = kernel.maker.partition(":")
    module = importlib.import_module(place)
    assert callable(getattr(module, maker))
    plain = getattr(module, kernel.name)
    parameters = inspect.signature(getattr(plain, "py_func", plain)).parameters
    assert len(parameters) == len(kernel.types)
    assert all(text_of(type_of(text)) == text for text in kernel.types)


def test_kernels_are_named_once_and_the_longest_come_first() -> None:
    named = signatures()
    assert len(set(named)) == len(named)
    lengths = [sum(len(text) for text in kernel.types) for kernel in named]
    assert lengths == sorted(lengths, reverse=True)
