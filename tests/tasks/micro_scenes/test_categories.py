from __future__ import annotations

import csv
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.capture.labels import NYU40
from tasks.furniture import CATEGORIES
from tasks.micro_scenes.categories import read_categories

OWN = read_categories()

PLAIN = "object: {large: true, small: true, source: inferred, words: [thing]}\n"


def test_the_table_is_the_papers_as_far_as_it_can_be_read() -> None:
    assert len(OWN.names) == 60
    assert list(OWN.names) == sorted(OWN.names)
    assert sum(source == "paper" for source in OWN.sources.values()) == 49
    assert OWN.large | OWN.small == set(OWN.names)
    assert (len(OWN.large - OWN.small), len(OWN.large & OWN.small), len(OWN.small - OWN.large)) == (17, 8, 35)
    assert OWN.small >= {"basket", "bucket", "kettle", "object"}, "as the paper underlines"


@given(st.sampled_from(sorted(OWN.words)), st.sampled_from([" ", "_", "-", "  "]), st.booleans(), st.sampled_from(["", " 3", "_02"]))
def test_every_word_is_found_however_it_is_written(word: str, blank: str, is_upper: bool, number: str) -> None:
    written = word.replace(" ", blank)
    assert OWN.merged((written.upper() if is_upper else written) + number) == OWN.words[word]
    assert OWN.merged("".join(part.capitalize() for part in word.split())) == OWN.words[word] or word in {"3d printer", "t shirt"}


@pytest.mark.parametrize(
    ("word", "category"),
    [
        ("wooden kitchen table", "dining_table"), ("Bookshelves", "shelf"), ("knives", "kitchenware"), ("batteries", "object"),
        ("SofaChair_01", "chair"), ("night stands", "nightstand"), ("toys", "toy"), ("ChairA", "chair"), ("potted_plant", "plant"),
        ("mouse pad", "mouse_pad"), ("dishes", "kitchenware"), ("glasses", "cup"), ("", "object"), ("spaceship", "object"), ("7", "object"),
    ],
)  # fmt: skip
def test_words_of_others(word: str, category: str) -> None:
    assert OWN.merged(word) == category


def test_the_lakes_own_words_have_a_category_of_their_own() -> None:
    """What does not is part of the house, hangs, covers the floor, or is told apart by nobody."""
    assert {word for word in CATEGORIES if OWN.merged(word) == "object"} == {
        "blinds", "candle", "ceiling fan", "clock", "curtain", "door", "dumbbell", "mirror", "radiator", "range hood", "rug", "sculpture",
        "shower", "shower curtain", "vase", "whiteboard", "window",
    }  # fmt: skip
    told = {name for name in NYU40 if OWN.merged(name) != "object"}
    assert told >= {"cabinet", "bed", "books", "refridgerator", "television", "night stand", "shelves", "clothes", "bag", "towel", "box"}


@pytest.mark.realdata
def test_most_objects_of_scannet_have_a_category(realdata) -> None:
    table = csv.DictReader(realdata("labels/scannetv2-labels.combined.tsv").read_text().splitlines(), delimiter="\t")
    movable = [row for row in table if row["nyu40class"] not in ("wall", "floor", "ceiling", "door", "window", "otherstructure", "curtain")]
    count = sum(int(row["count"] or 0) for row in movable)
    assert sum(int(row["count"] or 0) for row in movable if OWN.merged(row["raw_category"]) != "object") > 0.85 * count


@pytest.mark.parametrize(
    ("text", "field", "problem"),
    [
        ("- a\n", "content", "must be a table"),
        ("", "content", "must be a table"),
        ("object: 3\n", "object", "must be a table"),
        ("a: [\n", "line 2", "is no YAML"),
        (PLAIN + "mug: {large: false, small: true, source: guess, words: []}\n", "mug.source", "must be paper or inferred"),
        (PLAIN + "mug: {large: maybe, small: true, source: paper, words: []}\n", "mug.large", "must be true or false"),
        (PLAIN + "mug: {large: false, small: false, source: paper, words: []}\n", "mug.small", "must be true"),
        (PLAIN + "mug: {large: false, small: true, source: paper}\n", "mug.words", "is missing"),
        (PLAIN + "mug: {large: false, small: true, source: paper, words: [], color: red}\n", "mug.color", "is no field"),
        (PLAIN + "mug: {large: false, small: true, source: paper, words: cup}\n", "mug.words", "must be a list"),
        (PLAIN + "mug: {large: false, small: true, source: paper, words: [[cup]]}\n", "mug.words", "must be a text"),
        (PLAIN + "mug: {large: false, small: true, source: paper, words: [Thing]}\n", "mug.words", "is a word of object already"),
        (PLAIN + "mug: {large: false, small: true, source: paper, words: ['-']}\n", "mug.words", "has an empty word"),
        (PLAIN + PLAIN, "object", "is there twice"),
        (PLAIN + "Mug Cup: {large: false, small: true, source: paper, words: []}\n", "Mug Cup", "is no name"),
        ("mug: {large: false, small: true, source: paper, words: []}\n", "object", "is missing"),
        ("object: {large: true, small: false, source: paper, words: []}\n", "object.small", "must be true"),
        ("[" * 20_000, "content", "is nested too deep"),
        (PLAIN + "#" * 140_000, "size", "at most"),
        (PLAIN + "mug: !!python/object/apply:os.getcwd []\n", "mug", "must be a table"),
    ],
)
def test_a_table_that_is_none_is_refused_by_file_and_field(text: str, field: str, problem: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        read_categories(file)
    assert (caught.value.file, caught.value.field) == ("mine.yaml", field)
    assert problem in str(caught.value)


def test_a_table_that_is_no_text_or_not_there_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_bytes(b"\xff\xfe\x00")
    for name in ("mine.yaml", "none.yaml"):
        with pytest.raises(InputError, match=name):
            read_categories(tmp_path / name)


def test_aliases_of_a_table_multiply_nothing(tmp_path: Path) -> None:
    """A document of the kind that becomes gigabytes where aliases are followed."""
    lines = ["a0: &a0 {x: 1}", *(f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}" for i in range(1, 60))]
    (tmp_path / "mine.yaml").write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"a0\."):
        read_categories(tmp_path / "mine.yaml")
