"""What a raw label of a scan means: its category and its NYU40 class."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import io
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.capture.files.documents import read_text
from tasks.capture.spelling import SHORT_LETTERS, is_english, respelled, slips
from tasks.furniture import is_known, typical_extents

NYU40 = (
    "unlabeled", "wall", "floor", "cabinet", "bed", "chair", "sofa", "table", "door", "window", "bookshelf", "picture", "counter", "blinds",
    "desk", "shelves", "curtain", "dresser", "pillow", "mirror", "floor mat", "clothes", "ceiling", "books", "refridgerator", "television",
    "paper", "towel", "shower curtain", "box", "whiteboard", "person", "night stand", "toilet", "sink", "lamp", "bathtub", "bag",
    "otherstructure", "otherfurniture", "otherprop",
)  # fmt: skip
"""Names of the NYU40 classes by id, in that data set's own spelling; 0 is none of them."""

WALL, FLOOR, DOOR, WINDOW, CEILING, OTHER_PROP = 1, 2, 8, 9, 22, 40
STRUCTURE = frozenset({WALL, FLOOR, CEILING})
"""Classes that are part of the room and never replaced by an asset."""


LIKE_SIZE = 1.6
"""Factor within which objects of a category are as large as its usual one, along each of their sides."""

NOT_UNLIKE_SIZE = 2.5
"""The same where the label is no word, and near to a single one of the map's: what was seen in part, or is bent, is one as well."""

THIN_M = 0.06
"""Sides that are thinner are of one size [m]: the noise of a scan is as thick as a rug."""

LEAST_SIZE_M = 0.7
"""Of furniture [m]: among what is smaller, much has a size that many other objects have."""


@dataclasses.dataclass(frozen=True)
class Label:
    """Meaning of a raw label. `is_known` is False when the map does not have it: the NYU40 id is 0 then. is_respelled: it was taken for
    one that the map has, with a slip of the hand."""

    category: str
    nyu40_id: int
    is_known: bool
    is_respelled: bool = False

    @property
    def nyu40_label(self) -> str:
        """Name of the NYU40 class, 'unlabeled' for 0."""
        return NYU40[self.nyu40_id]

    @property
    def is_structure(self) -> bool:
        """Wall, floor or ceiling."""
        return self.nyu40_id in STRUCTURE


@dataclasses.dataclass(frozen=True)
class LabelMap:
    """Meanings by normalised raw label, and the hash of the file that they came from."""

    entries: Mapping[str, tuple[str, int]]
    sha256: str

    def __getitem__(self, raw_label: str) -> Label:
        """Meaning of a label; letter case, blanks, underscores, dashes and one slip of the hand do not matter."""
        text = normalized(raw_label)
        joined = text.replace(" ", "")  # a book case
        for form in (text, joined):
            if form in self.entries:
                return Label(*self.entries[form], is_known=True)
        for form in (text, joined):
            right = respelled(form, self.entries)
            if right is not None:
                return Label(*self.entries[right], is_known=True, is_respelled=True)
        return Label(text or "unlabeled", 0, is_known=False)

    def of_size(self, raw_label: str, size_as: Callable[[str], NDArray[np.float64]]) -> Label:
        """Meaning of a label of an object, of which `size_as` says how large it is if it is of a category [m], shape (3,): a short word,
        or one that English has and the map has not, is a slip of the hand where what it is one letter away from is as large as the
        object. A tale that is as large as a table is one, and so is a rg that is as large as a rug. Where a label is one letter away from
        several, it is furniture that has the object's size before anything else: a soaf of two metres is a sofa, no soap."""
        label = self[raw_label]
        if label.is_known and not label.is_respelled:
            return label
        text = normalized(raw_label)
        near = slips(text, self.entries, least_letters=SHORT_LETTERS)
        likely = [
            right for right in near if is_known(self.entries[right][0]) and max(typical_extents(self.entries[right][0])) >= LEAST_SIZE_M
        ]
        is_sure = len(likely if label.is_respelled else near) == 1 and not is_english(text)
        for right in likely:
            meaning = self.entries[right]
            if is_of_size(size_as(meaning[0]), typical_extents(meaning[0]), NOT_UNLIKE_SIZE if is_sure else LIKE_SIZE):
                return Label(*meaning, is_known=True, is_respelled=True)
        return label

    def of_node(self, category: str, model: str) -> Label:
        """Meaning of a named node of a scene, whose names come from no vocabulary.

        Tried in turn: the category as it is; its last words; the words of the model's name (`HouseWallB_01` is
        `house wall b`), longest ending first. Single letters and numbers in names do not count.
        """
        for text in (normalized(category), _words(category), _words(model)):
            words = text.split()
            for start in range(len(words)):
                ending = " ".join(words[start:])
                if ending in self.entries:
                    return Label(*self.entries[ending], is_known=True)
        return Label(_words(category) or normalized(category) or "unlabeled", 0, is_known=False)


def is_of_size(size: NDArray[np.float64], usual: Sequence[float], slack: float = LIKE_SIZE) -> bool:
    """Whether a box [m], shape (3,), is about as large as another, within a factor: its height, its longer side in plan and its shorter."""
    if not np.all(np.asarray(size[:2]) > 0.0):
        return False
    own, other = (np.maximum([*sorted(map(float, extents[:2])), float(extents[2])], THIN_M) for extents in (size, usual))
    return bool(np.abs(np.log(own / other)).max() <= np.log(slack))


def normalized(raw_label: str) -> str:
    """Lower case, single spaces, no underscores or dashes."""
    return " ".join(re.sub(r"[_\-\s]+", " ", raw_label.lower()).split())


def label_map(path: str | None = None) -> LabelMap:
    """The project's own label map, or a user's: ScanNet's `scannetv2-labels.combined.tsv`, or a CSV like `labels.csv`.

    Raises:
        InputError: the user's file is no label map.
    """
    if path is None:
        return _own()
    file = Path(path)
    return _parsed(read_text(file, file.name), file.name)


@cache
def _own() -> LabelMap:
    file = Path(__file__).with_name("labels.csv")
    return _parsed(read_text(file, file.name), file.name)


def _parsed(text: str, name: str) -> LabelMap:
    first = text.partition("\n")[0]
    rows = csv.DictReader(io.StringIO(text, newline=None), delimiter="\t" if "\t" in first else ",")
    try:
        entries = _entries(rows, name)
    except csv.Error as error:
        raise InputError(name, "content", f"is no table ({error})", "save it as UTF-8 text") from error
    return LabelMap(entries, hashlib.sha256(text.encode()).hexdigest())


def _entries(rows: csv.DictReader[str], name: str) -> dict[str, tuple[str, int]]:
    """Category and NYU40 class by raw label."""
    fields = rows.fieldnames or []
    raw_field = "raw_category" if "raw_category" in fields else "raw_label"
    id_field = "nyu40id" if "nyu40id" in fields else "nyu40_id"
    for field in (raw_field, "category", id_field):
        if field not in fields:
            remedy = "use scannetv2-labels.combined.tsv or a CSV of raw_label, category, nyu40_id"
            raise InputError(name, field, "the column is missing", remedy)
    entries: dict[str, tuple[str, int]] = {}
    for number, row in enumerate(rows, start=2):
        raw, category, nyu40 = (normalized(row[field] or "") for field in (raw_field, "category", id_field))
        if not re.fullmatch(r"\d{1,2}", nyu40) or int(nyu40) >= len(NYU40):
            raise InputError(name, f"line {number}, {id_field}", f"must be 0 to 40, is {nyu40[:20]!r}", "correct the line")
        entries.setdefault(raw, (category or raw, int(nyu40)))
    return entries


def _words(name: str) -> str:
    """Words of a name in camel case, without numbers and single letters: `HouseWallB_01_001` to `house wall`."""
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)
    return " ".join(part.lower() for part in parts if len(part) > 1)
