"""Stated distributions: equal to a listing of all outcomes, and what draws follow."""

from __future__ import annotations

from collections import Counter
from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.furniture import CATEGORIES, tops
from tasks.furniture.tops.laws import Choice, Rule, TopItem
from tasks.furniture.tops.sizes import LARGE, SMALL
from tasks.micro_scenes.categories import read_categories

ERRORS = 5.0
"""Standard errors that a mean of draws may be off: by chance once in two million."""

KINDS = ("bathroom", "bedroom", "dining room", "kitchen", "living room", "office")


@st.composite
def counts(draw) -> tuple[float, ...]:
    weights = draw(st.lists(st.integers(0, 4), min_size=1, max_size=3).filter(any))
    return tuple(weight / sum(weights) for weight in weights)


@st.composite
def rules(draw) -> Rule:
    choices = []
    for _ in range(draw(st.integers(1, 3))):
        options = draw(st.lists(st.lists(st.tuples(st.sampled_from("abc"), counts()), max_size=2), min_size=1, max_size=2))
        shares = np.array([draw(st.integers(1, 4)) for _ in options]) / draw(st.integers(4 * len(options), 10))
        shares = shares / max(1.0, shares.sum())
        choices.append(Choice(tuple((float(s), tuple(TopItem(*item) for item in items)) for s, items in zip(shares, options, strict=True))))
    return Rule(tuple(choices))


def outcomes(rule: Rule) -> dict[tuple[str, ...], float]:
    """Probability of each sorted list of words, empty ones discarded, by listing everything that can be drawn."""
    law: Counter = Counter()
    per_choice = []
    for choice in rule.choices:
        ends = [(1.0 - sum(share for share, _ in choice.options), ())]
        for share, items in choice.options:
            for numbers in product(*(range(len(item.counts)) for item in items)):
                chance = share * np.prod([item.counts[n] for item, n in zip(items, numbers, strict=True)])
                ends.append((chance, tuple(item.word for item, n in zip(items, numbers, strict=True) for _ in range(n))))
        per_choice.append(ends)
    for ends in product(*per_choice):
        law[tuple(sorted(word for _, words in ends for word in words))] += float(np.prod([chance for chance, _ in ends]))
    del law[()]
    total = sum(law.values())
    return {words: chance / total for words, chance in law.items() if total > 0}


@settings(max_examples=40, deadline=None)
@given(rules())
def test_stated_laws_are_those_of_all_outcomes(rule):
    listed = outcomes(rule)
    if not listed or sum(rule.means().values()) < 1e-9:
        return
    numbers = np.zeros(1 + max(map(len, listed)))
    shares: Counter = Counter()
    for words, chance in listed.items():
        numbers[len(words)] += chance
        for word in words:
            shares[word] += chance
    stated = rule.count_law()
    length = max(len(stated), len(numbers))
    assert np.allclose(np.pad(stated, (0, length - len(stated))), np.pad(numbers, (0, length - len(numbers))))
    means, total = rule.means(), sum(shares.values())
    for word in set(means) | set(shares):
        assert means.get(word, 0.0) / sum(means.values()) == pytest.approx(shares[word] / total)


def assert_follows(word: str, room_type: str, number: int, seed: int) -> None:
    """Counts of all categories and of objects of so many draws are within `ERRORS` standard errors of what is stated."""
    categories = read_categories()
    rng = np.random.default_rng(seed)
    rule = tops.rule(word, room_type)
    merged = {item.word: categories.merged(item.word) for item in rule.items()}
    drawn = [Counter(merged[item.word] for item in rule.draw(rng)) for _ in range(number)]
    law, shares = tops.stated_count(word, room_type), tops.stated_distribution(word, room_type)
    mean = float(law @ np.arange(len(law)))
    assert sum(shares.values()) == pytest.approx(1.0)
    assert set().union(*drawn) <= set(shares)
    for category, share in shares.items():
        found = np.array([one[category] for one in drawn])
        # what is rare has too few draws to know its spread from: it is at least that of a Poisson law
        error = max(float(found.std()), np.sqrt(share * mean)) / np.sqrt(number)
        assert abs(found.mean() - share * mean) <= ERRORS * error, (word, room_type, category)
    counts = np.bincount([one.total() for one in drawn], minlength=len(law))
    assert len(counts) == len(law)
    assert (np.abs(counts / number - law) <= ERRORS * np.sqrt(law * (1 - law) / number) + 1.0 / number).all(), (word, room_type)


@pytest.mark.parametrize("room_type", KINDS)
def test_draws_follow_what_is_stated(room_type):
    for word in sorted(word for word, kind in tops.PAIRS if kind == room_type):
        assert_follows(word, room_type, 400, 7)


@pytest.mark.whole
@pytest.mark.parametrize("room_type", KINDS)
def test_many_draws_follow_what_is_stated(room_type):
    for seed, word in enumerate(("table", "desk", "cabinet")):
        assert_follows(word, room_type, 20_000, seed)


@settings(max_examples=120, deadline=None)
@given(st.sampled_from(tops.PAIRS), st.integers(0, 2**32 - 1), st.tuples(*[st.floats(0.25, 3.0)] * 3))
def test_what_is_drawn_does_not_depend_on_the_size(pair, seed, size):
    word, room_type = pair
    wanted = Counter(item.word for item in tops.rule(word, room_type).draw(np.random.default_rng(seed)))
    assert Counter(tops.draw(word, size, room_type, np.random.default_rng(seed)).words) == wanted


def test_layouts_of_a_table_are_near_what_is_stated_and_far_from_those_of_other_rooms():
    categories = read_categories()
    stated = {kind: tops.stated_distribution("table", kind) for kind in KINDS}
    for kind in KINDS:
        rng = np.random.default_rng(11)
        size = tops.typical_size("table", rng)
        found: Counter = Counter()
        for _ in range(200):
            found.update(categories.merged(word) for word in tops.draw("table", size, kind, rng).words)
        shares = {name: number / found.total() for name, number in found.items()}
        assert distance(shares, stated[kind]) < 0.1
    assert min(distance(stated[a], stated[b]) for a, b in combinations(KINDS, 2)) > 0.3


def distance(a: dict[str, float], b: dict[str, float]) -> float:
    """Total variation."""
    return 0.5 * sum(abs(a.get(name, 0.0) - b.get(name, 0.0)) for name in set(a) | set(b))


def test_rules_name_what_is_known_and_suits_a_micro_scene():
    categories = read_categories()
    assert len(tops.PAIRS) >= 34
    assert {(word, kind) for word in ("table", "desk", "cabinet") for kind in KINDS} <= set(tops.PAIRS)
    assert {word for word, _ in tops.PAIRS} == set(LARGE)
    assert all(categories.is_large(categories.merged(word)) for word in LARGE)
    assert set(SMALL) <= set(CATEGORIES)
    for word, room_type in tops.PAIRS:
        law = tops.stated_count(word, room_type)
        assert law.sum() == pytest.approx(1.0)
        assert law[0] == 0.0
        assert len(law) - 1 <= 12
        assert 3.8 <= law @ np.arange(len(law)) <= 7.0
        for item in tops.rule(word, room_type).items():
            assert item.word in SMALL
            assert categories.is_small(categories.merged(item.word)), item.word
            assert set(item.carriers) <= set(SMALL)


@pytest.mark.parametrize("call", [tops.rule, tops.stated_distribution, tops.stated_count])
def test_pairs_without_a_rule_are_named(call):
    with pytest.raises(ValueError, match="bed"):
        call("bed", "kitchen")


@pytest.mark.parametrize("shares", [(0.5, 0.4), (1.2, -0.2)])
def test_counts_that_are_no_probabilities_are_refused(shares):
    with pytest.raises(ValueError, match="probabilities"):
        TopItem("mug", shares)
