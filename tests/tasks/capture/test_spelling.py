"""Labels with a slip of the hand are read as the label that was meant; real words never are."""

from __future__ import annotations

import numpy as np
import pytest

from tasks.capture.labels import label_map, normalized
from tasks.capture.spelling import respelled
from tasks.scanner.defects import misspelled


@pytest.mark.parametrize(
    ("raw", "category"),
    [
        ("hcair", "chair"), ("Cchair", "chair"), ("plte", "plate"), ("icrowave", "microwave"), ("kitchen_cabnet", "kitchen cabinet"),
        ("ofice chair", "office chair"),
        ("office chari", "office chair"), ("coffee tale", "coffee table"), ("book cse", "bookshelf"),
        ("bookhself", "bookshelf"), ("wlal", "wall"), ("tolet", "toilet"),
    ],
)  # fmt: skip
def test_a_slip_is_read_as_what_was_meant(raw: str, category: str) -> None:
    label = label_map()[raw]
    assert (label.category, label.is_known, label.is_respelled) == (category, True, True)
    assert label.nyu40_id == label_map()[category].nyu40_id


@pytest.mark.parametrize("raw", ["tale", "house", "bear", "pat", "object 17", "lmp", "", "会议室", "x" * 200, "red hcair"])
def test_what_is_a_word_or_too_short_or_nothing_known_stays(raw: str) -> None:
    label = label_map()[raw]
    assert (label.category, label.is_known, label.nyu40_id) == (normalized(raw) or "unlabeled", False, 0)


@pytest.mark.parametrize(
    ("raw", "size", "category"),
    [
        ("tale", (0.87, 1.3, 0.83), "table"), ("tale", (1.3, 0.87, 0.83), "table"), ("tale", (0.2, 0.2, 0.2), None),
        ("char", (0.5, 0.5, 0.9), "chair"), ("house", (0.3, 0.2, 0.3), None), ("hcair", (3.0, 3.0, 3.0), "chair"),
        ("table", (0.1, 0.1, 0.1), "table"), ("tale", (0.0, 0.0, 0.0), None),
        ("rg", (2.6, 3.3, 0.01), "rug"), ("rg", (2.6, 3.3, 0.5), None), ("rg", (0.3, 0.4, 0.01), None),  # a rug is flat
        ("sfa", (1.86, 2.22, 0.74), "sofa"), ("sfa", (0.2, 0.2, 0.2), None), ("lmp", (0.2, 0.2, 0.4), None),  # lamps are of any size
        ("a", (1.6, 2.3, 0.01), None),
        ("soaf", (2.11, 1.8, 0.66), "sofa"), ("soaf", (0.08, 0.06, 0.03), "soap"), ("soaf", (5.0, 4.0, 2.5), "soap"),
    ],
)  # fmt: skip
def test_a_word_that_no_map_has_is_a_slip_where_the_object_is_as_large(raw: str, size: tuple[float, ...], category: str | None) -> None:
    label = label_map().of_size(raw, lambda _: np.array(size))
    assert label.category == (category or raw)
    assert label.is_known == (category is not None)
    assert label.is_respelled == (category is not None and raw != category)


def test_every_label_of_the_map_means_itself() -> None:
    known = label_map()
    for raw, (category, nyu40) in known.entries.items():
        label = known[raw]
        assert (label.category, label.nyu40_id, label.is_respelled) == (category, nyu40, False)


@pytest.mark.whole
def test_most_slips_are_put_right_and_hardly_any_is_taken_for_something_else() -> None:
    known, rng = label_map(), np.random.default_rng(0)
    tries = [(category, known[misspelled(raw, rng)]) for raw, (category, _) in known.entries.items() if len(raw) >= 4]
    read = [(category, label.category) for category, label in tries if label.is_known]
    assert len(read) > 0.8 * len(tries)
    assert sum(meant == taken for meant, taken in read) > 0.98 * len(read)


def test_only_one_word_is_put_right() -> None:
    assert respelled("ofice chiar", {"office chair"}) is None
    assert respelled("ofice chair", {"office chair"}) == "office chair"
