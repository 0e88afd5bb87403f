"""Where in a small image instances are."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.capture.instances.views import _compiled, _contact, border_contact


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), h=st.integers(1, 12), w=st.integers(1, 12), count=st.integers(1, 5))
def test_extents_are_those_of_masks(seed: int, h: int, w: int, count: int) -> None:
    label = np.random.default_rng(seed).integers(-1, count, (h, w))
    extents = _compiled()["_extents"](label, count)
    assert extents.shape == (count, 6)
    for instance, (size, touching, *ends) in enumerate(extents.tolist()):
        mask = label == instance
        assert size == mask.sum()
        assert _contact(touching, size) == border_contact(mask)
        if size:
            rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
            assert ends == [rows[0], rows[-1], columns[0], columns[-1]]
