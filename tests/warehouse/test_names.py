"""One spelling per quantity: what columns of tables, views and macros are called, by type and unit, and every exception with its reason."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator

import pytest

from schemas.tables import TABLES
from warehouse.questions.catalog import described, empty_lake
from warehouse.questions.documentation import sql_type
from warehouse.questions.macros import macros
from warehouse.questions.renames import RENAMES
from warehouse.questions.views import views

SUFFIXES = {
    "m": "m", "m2": "m2", "m3": "m3", "kg": "kg", "kg/m3": "kg_m3", "s": "seconds", "rad": "radians", "px": "px", "B": "bytes", "MB": "mb",
    "USD": "usd",
}  # fmt: skip
"""How the name of a column ends whose description states this unit."""

ENDINGS = {
    **{suffix: f"unit {unit}" for unit, suffix in SUFFIXES.items()},
    "degrees": "an angle for people, in views; tables have radians",
    "share": "a part of a whole, 0 to 1",
}
"""What the name of a number that is no count ends on; `_low`, `_high` and `_95` may follow, of its interval."""

MINUTES = ("annotation_timing", "annotation_timing_by_scene")
"""Views in minutes: the paper states the annotation of scenes in them."""

PLAIN = {
    "score": "as its provider has it, larger is better", "f_2cm f_5cm f_10cm": "F-score at a distance, the field's",
    "completeness_2cm completeness_5cm completeness_10cm": "the field's", "accuracy_2cm accuracy_5cm accuracy_10cm": "the field's",
    "coverage": "the field's word for how much of a surface is matched, or of a texture used",
    "box_iou oriented_iou": "intersection over union", "color_similarity structural_similarity color_difference": "CIEDE2000, SSIM",
    "color_kl category_kl": "divergences, in nats", "sr spl sel el el_success found_spl": "the field's measures of navigation",
    "top_1 top_5 top_1_without_own": "the field's", "agreement chance_agreement cohens_kappa kendalls_tau": "the field's",
    "friction restitution": "coefficients", "solid_fraction": "physics' word, and that of prompts and of the table of categories",
    "category_probability p_value p_value_by_scene p_value_by_seed": "probabilities", "learning_rate": "of the optimizer",
    "fidelity_loss": "of an F-score",
    "loss smallest_loss loss_start loss_final loss_before loss_after": "their unit is the method's, said beside them",
    "value low high validation": "of the metric beside them", "doubt": "a rank of what to ask, 0 to 1", "nees": "normalized by its spread",
    "first_mean second_mean difference": "of the measure beside them", "pass wrong": "bounds of shares, pass_low to wrong_high",
    "stretch_l2 stretch_linf": "Sander's, 1 is best", "seam_ratio size_ratio chart_ratio": "lengths, sizes, counts over others",
    "times_median times_paper": "how many times as much", "depth_scale": "units of a depth image per metre, the formats' word",
}  # fmt: skip
"""Numbers without a unit, by name or by the name behind a prefix such as `mean_`, and why."""

COUNTED = {
    "actions", "busy_workers", "charts", "collisions", "faces", "objects", "objects_per_scene", "rank", "recoveries", "reply_tokens",
    "retries", "scenes",
}  # fmt: skip
"""What means, medians and the like are taken of that is counted: then they are no whole numbers."""

EACH = ("m", "m2", "hour", "scene", "object", "39_objects", "second", "answer")
"""What something is so much for each of, as `_per_` says: `seconds_per_object`."""

PREFIXES = ("mean", "median", "p90", "p95", "least", "greatest", "lowest", "best", "regret", "object", "shell", "library", "winning")
"""Statistics, and whose measure it is."""

UNITED = {
    "frames.width": "pixels of an image, as all formats call it", "frames.height": "as width",
    "frames.depth_scale": "1/m: the formats' word", "masks.pixel_count": "a count of pixels says so",
}  # fmt: skip
"""Single numbers with a unit that their names do not end on, and why."""

PREDICATES = {
    "passed": "an export, a rule", "passes": "an answer", "counts": "a batch", "counts_unreviewed": "as counts", "called_stop": "the agent",
    "success": "Habitat's measure, of one trajectory", "arrived": "as success", "found": "as success",
}  # fmt: skip
"""Truth values that begin with neither `is_` nor `has_`: said of what the row is about."""

TWICE = {
    "height": "of an image in pixels, as all formats call it; height_m of things", "width": "as height",
    "passed": "of an answer in review: annotation_batch_states counts them beside judged and failed",
}  # fmt: skip
"""Names that stand with and without a suffix, or for a truth value and for a number, and why."""

SPELLED_OTHERWISE = re.compile(
    r"_(metres?|meters?|cm|mm|km|sec|secs|s|ms|milliseconds|hours?|hrs|deg|rads?|rad|percent|pct|fraction|kb|gb|size_b|grams?|g|eur|dollars)$"
)
"""What no name ends on: another spelling or scale of a unit. A distance that is part of a measure's name (`f_5cm`) is none."""


TYPES = ("VARCHAR", "BIGINT", "DOUBLE", "BOOLEAN", "TIMESTAMP WITH TIME ZONE", "TIMESTAMPTZ")
"""Types of columns, and lists of them: whole numbers are of one size everywhere."""


@pytest.fixture(scope="module")
def relations() -> dict[str, dict[str, str]]:
    """SQL types of the columns of every table, view and table macro, by name; old names left out."""
    former = {rename.before for rename in RENAMES}
    found = {table.name: {column.name: sql_type(column.type) for column in table.columns} for table in TABLES.values()}
    with empty_lake() as connection:
        for question in (*views(), *macros()):
            columns = described(connection, question).get("columns", {})
            found[question.name] = {name: kind for name, kind in columns.items() if question.name not in MACROS or name not in former}
    return found


MACROS = {macro.name for macro in macros()}


def of_kind(relations: dict[str, dict[str, str]], *kinds: str) -> Iterator[tuple[str, str]]:
    return ((relation, name) for relation, columns in relations.items() for name, kind in columns.items() if kind in kinds)


def quantity(name: str) -> str:
    """A name without the end of an interval."""
    return re.sub(r"_(low|high|95)$", "", name)


def is_named(relation: str, name: str) -> bool:
    """Whether a number that is no count says by its name what unit it has, or that it has none."""
    name = quantity(name)
    if relation in MINUTES and re.search(r"(^|_)minutes", name):
        return True
    measured, per, each = name.rpartition("_per_")
    if per:  # so much for each: what is measured has its unit or is counted, or its unit is that of one over what follows
        is_inverse = each in SUFFIXES.values() and not re.search(rf"_({'|'.join(ENDINGS)})$", measured)
        return each in EACH and (is_inverse or is_named(relation, measured) or measured in COUNTED)
    if re.search(rf"(^|_)({'|'.join(ENDINGS)})$", name):
        return True
    known = {one for names in PLAIN for one in names.split()}
    rest, last = name, ""
    while rest != last:
        if rest in known or (rest != name and rest in COUNTED):
            return True
        last, rest = rest, re.sub(rf"^({'|'.join(PREFIXES)})_", "", rest)
    return False


def test_columns_with_a_unit_end_on_it_and_others_do_not() -> None:
    wrong, excepted = [], set()
    for table in TABLES.values():
        for column in table.columns:
            place, is_list = f"{table.name}.{column.name}", "list" in str(column.type)
            ending = SUFFIXES.get(column.unit)
            ends = ending is not None and re.search(rf"(^|_){ending}$", column.name) is not None
            claims = [unit for unit, suffix in SUFFIXES.items() if re.search(rf"(^|_){suffix}$", column.name)]
            if place in UNITED:
                excepted.add(place)
            elif column.unit and not is_list and not ends:
                wrong.append(f"{place}: [{column.unit}], but its name does not end on {ending or 'a suffix that is agreed on'}")
            if claims and not ends and not (is_list and "," in column.unit):
                wrong.append(f"{place}: its name says {claims}, its unit is {column.unit or 'none'}")
    assert wrong == []
    assert excepted == UNITED.keys(), "exceptions of columns that are gone"


def test_numbers_that_are_no_counts_say_their_unit(relations: dict[str, dict[str, str]]) -> None:
    wrong = [f"{relation}.{name}" for relation, name in of_kind(relations, "DOUBLE") if not is_named(relation, name)]
    assert wrong == []
    used = {part for _, name in of_kind(relations, "DOUBLE") for part in _parts(quantity(name))}
    assert {one for names in PLAIN for one in names.split()} - used == set(), "reasons for names that are gone"


def _parts(name: str) -> list[str]:
    """A name, and what is left of it without each of its first words."""
    words = name.split("_")
    return ["_".join(words[at:]) for at in range(len(words))]


def test_no_name_has_another_spelling_of_a_unit(relations: dict[str, dict[str, str]]) -> None:
    names = {name for columns in relations.values() for name in columns}
    odd = {name for name in names if SPELLED_OTHERWISE.search(name) and not re.search(r"_\d+cm$|_per_hour$", name)}
    assert odd - {"solid_fraction"} == set()


def test_angles_are_radians_in_tables_and_degrees_in_views(relations: dict[str, dict[str, str]]) -> None:
    for relation, columns in relations.items():
        rows_of = [table for table in TABLES if relations[table].keys() <= columns.keys() and relation not in TABLES]
        turned = [name for name in columns if re.search(r"(^|_)(radians|degrees)(_|$)", name)]
        stored = relation in TABLES or rows_of  # a view of a table's rows has them as they are
        assert [name for name in turned if name.endswith("degrees") == bool(stored)] == [], relation


def test_truth_values_are_said_as_such(relations: dict[str, dict[str, str]]) -> None:
    said = re.compile(r"(is|has)_\w+")
    wrong = [f"{r}.{name}" for r, name in of_kind(relations, "BOOLEAN") if not said.fullmatch(name) and name not in PREDICATES]
    assert wrong == []
    numbers = {name for _, name in of_kind(relations, "BIGINT", "DOUBLE")}
    assert [name for name in numbers if said.fullmatch(name)] == []
    assert PREDICATES.keys() - {name for _, name in of_kind(relations, "BOOLEAN")} == set(), "predicates that are gone"


def test_a_name_stands_for_one_kind_of_quantity(relations: dict[str, dict[str, str]]) -> None:
    """Counts are whole, measures are not, truth values neither; a name with a unit is not spelled without it elsewhere."""
    kinds: dict[str, set[str]] = defaultdict(set)
    for columns in relations.values():
        for name, kind in columns.items():
            assert kind in TYPES or kind.endswith("[]"), (name, kind)
            kinds[name].add(kind)
    several = {name for name, found in kinds.items() if len(found & {"BIGINT", "DOUBLE", "BOOLEAN"}) > 1}
    endings = "|".join(ending for ending in ENDINGS if ending != "share")
    numbers = {name for name, found in kinds.items() if any(kind.rstrip("[]") in ("BIGINT", "DOUBLE") for kind in found)}
    bare = {stem for name in numbers if (stem := re.sub(rf"_({endings})$", "", name)) != name and stem in numbers}
    assert several | bare == TWICE.keys()
