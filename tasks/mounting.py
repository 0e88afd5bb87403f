"""How categories are usually carried: what hangs, what is let into a wall, what covers, what is built in.

A prior only: where a category says nothing, the geometry decides alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from typing import Literal

Kind = Literal["let_in", "wall", "frame", "ceiling", "either", "covering", "stands", "any"]
"""`let_in`: an opening's leaf, in the wall itself. `wall`: hangs wherever a wall or rail is near, even where it touches
something below. `frame`: hangs, unless it rests on something. `ceiling`: hangs from the ceiling. `either`: stands where
something carries it, else hangs. `covering`: lies flat, to be stood upon. `stands`: never hangs. `any`: unknown."""

Base = Literal["legs", "body", "pole"]
"""What furniture stands on: legs or a pole, which scans lose, or its whole body, whose lower part is hidden behind other furniture."""


@dataclasses.dataclass(frozen=True)
class Mounting:
    """How the objects of a category are carried. is_built_in: nobody picks them up or pushes them, wherever they stand. base: what
    they have below them where they stand on the floor; none where they stand on furniture as often. is_boxy: they fill their box.
    is_fitted: whoever sets them against a wall screws them to it. is_flat_topped: what is above their top stands on it."""

    kind: Kind
    is_built_in: bool = False
    base: Base | None = None
    is_boxy: bool = False
    is_fitted: bool = False
    is_flat_topped: bool = False


_KINDS: tuple[tuple[Kind, str, str], ...] = (
    ("let_in", "fills an opening of the wall", "door|doorframe|window|closet door|bathroom door|garage door|shower door"),
    ("wall", "is mounted where it is used; what it touches below does not carry it",
     "curtain|blinds|shower curtain|shower curtain rod|curtain rod|range hood|light switch|wall lamp|vent|air vent|rail|"
     "paper towel dispenser|hand dryer|power outlet|thermostat|fuse box|towel rail|towel bar"),
    ("frame", "hangs as a rule, but is also leaned and put on furniture",
     "picture|painting|poster|mirror|clock|whiteboard|blackboard|bulletin board|board|sign|calendar|map|towel|"
     "air conditioner|medicine cabinet|dart board|soap dispenser|toilet paper|toilet paper dispenser"),
    ("ceiling", "hangs over the room",
     "ceiling lamp|ceiling light|ceiling fan|chandelier|pendant lamp|hanging lamp|smoke detector|sprinkler"),
    ("either", "is sold in both forms: on feet, and with brackets",
     "tv|monitor|kitchen cabinet|cabinet|bathroom cabinet|cabinet door|shelf|bookshelf|rack|coat rack|spice rack|dish rack|speaker|"
     "projector|projector screen|lamp|light|fan|security camera|camera|heater|radiator|sink|urinal|toilet|telephone|fire extinguisher|"
     "power strip|tv stand|wall cabinet|hat|clothes|jacket|bag|plant|microwave|decoration"),
    ("covering", "is cloth or foam made to be stood upon",
     "rug|mat|carpet|floor mat|bath mat|doormat|yoga mat|tablecloth|table cloth|place mat|placemat"),
    ("stands", "has feet or a floor under it",
     "chair|office chair|armchair|sofa chair|folding chair|high chair|rocking chair|stool|bar stool|bench|ottoman|sofa|bean bag|"
     "futon|bed|bunk bed|crib|mattress|table|dining table|desk|coffee table|side table|end table|console table|round table|"
     "workbench|kitchen counter|kitchen island|counter|bar|nightstand|file cabinet|wardrobe|dresser|chest|trash can|recycling bin|"
     "bucket|suitcase|backpack|computer tower|printer|copier|laptop|keyboard|mouse|floor lamp|table lamp|desk lamp|refrigerator|"
     "mini fridge|oven|stove|dishwasher|washing machine|clothes dryer|vacuum cleaner|bathtub|piano|person|bicycle|ladder|"
     "treadmill|platform|pillow|cushion|blanket|storage bin|box|container|storage container|crate|basket|laundry basket|laundry hamper|"
     "book|book stack|mug|cup|glass|wine glass|bottle|can|jar|bowl|plate|tray|pot|pan|kettle|toaster|toaster oven|coffee maker|"
     "blender|vase|candle|sculpture|toy|stuffed animal|ball|shoe|tissue box|remote|remote control|desk organizer|umbrella|dumbbell|"
     "fruit|food|iron|cell phone|tablet|headphones|flower pot"),
)  # fmt: skip
"""Kind, why, and its categories."""

HOLDS_NOTHING: frozenset[str] = frozenset(
    {"plant", "sculpture", "statue", "lamp", "desk lamp", "floor lamp", "wine glass", "candle", "fan"}
)
"""Objects that others are never in: what is found among their leaves or arms stands beside them."""

LEANS: frozenset[str] = frozenset(
    {"book", "book stack", "pillow", "cushion", "blanket", "laptop", "tablet", "cell phone", "remote", "umbrella", "ladder", "bicycle",
     "bag", "backpack", "tray", "plate", "food", "fruit", "toy", "stuffed animal", "shoe", "person", "ball"}
)  # fmt: skip
"""What rests in any way: leaned on something, or fallen over."""

PARTS: frozenset[str] = frozenset({"drawer"})
"""Called by the name of a whole piece of furniture, and as often a part of one."""

FITTED: frozenset[str] = frozenset({"kitchen cabinet", "kitchen counter", "counter", "wall cabinet"})
"""Parts of fitted kitchens: cabinets and worktops."""

BUILT_IN: tuple[str, ...] = (
    "toilet", "urinal", "bathtub", "sink",  # pipes and sealant hold them
    "shower", "radiator", "fireplace", "stairs", "pillar", "column", "rail", "banister",  # parts of the house
    "door", "doorframe", "window", "closet door", "bathroom door", "garage door", "shower door",  # hinges and frames in the wall
)  # fmt: skip
"""What is fixed wherever it is. Stoves and refrigerators are not: two people push them; counters are where they stand against a wall."""


_BASES: tuple[tuple[Base, str], ...] = (
    ("legs",
     "chair|office chair|armchair|sofa chair|folding chair|high chair|rocking chair|stool|bar stool|bench|table|dining table|desk|"
     "coffee table|side table|end table|console table|round table|workbench|piano|crib|bunk bed|tv stand"),
    ("pole", "floor lamp"),
    ("body",
     "sofa|futon|bed|ottoman|bean bag|nightstand|file cabinet|wardrobe|dresser|kitchen island|refrigerator|oven|stove|dishwasher|"
     "washing machine|clothes dryer|bathtub|bookshelf|kitchen cabinet|cabinet|bathroom cabinet"),
)  # fmt: skip
"""What stands on the floor, and never on other furniture; a cabinet where it is not far above it."""

_BOXY = (
    "kitchen cabinet|cabinet|bathroom cabinet|kitchen counter|counter|nightstand|file cabinet|wardrobe|dresser|refrigerator|mini fridge|"
    "oven|stove|dishwasher|washing machine|clothes dryer|bookshelf|tv stand|wall cabinet"
)
"""What stands with its back to a wall, and of which a scan may have the front alone."""


_FLAT_TOPPED = (
    "table|dining table|desk|coffee table|side table|end table|console table|round table|workbench|kitchen counter|counter|nightstand|"
    "kitchen island|tv stand|bench|dresser|file cabinet|ottoman|platform"
)
"""What others are put on."""


UNNAMED = "object"
"""Category of what geometry told apart and could not name."""

SLAB_M, TABLE_M = 0.2, 0.4
"""A slab no thicker and no narrower is the top of a table [m]."""


@cache
def mounting(category: str) -> Mounting:
    """How objects of a category are carried; a longer name is taken by its last words, a plural by its singular, another word for
    furniture by the usual one: a couch is a sofa."""
    words = category.lower().replace("_", " ").replace("-", " ").split()
    for start in range(len(words)):
        name = " ".join(words[start:])
        for form in (name, name.removesuffix("s"), name.removesuffix("es")):
            if form in _mountings():
                return _mountings()[form]
    from tasks.furniture import canonical_category

    usual = _mountings().get(canonical_category(category) or "", Mounting("any"))
    return usual if usual.base is not None and category not in PARTS else Mounting("any")


def carried(category: str, size: Sequence[float], is_guessed: bool) -> Mounting:
    """How an object is carried whose box has a size [m]. What geometry told apart and could not name stands, if on nothing else: a slab on
    legs, as a table, the rest on what of it was hidden. is_guessed: the category is."""
    if not is_guessed or category != UNNAMED:
        return mounting(category)
    is_slab = size[2] <= SLAB_M and min(size[:2]) >= TABLE_M
    return Mounting("stands", base="legs" if is_slab else "body", is_flat_topped=is_slab)


@cache
def _mountings() -> dict[str, Mounting]:
    kinds = {name: kind for kind, _, names in _KINDS for name in names.split("|")}
    bases = {name: base for base, names in _BASES for name in names.split("|")}
    boxy, topped = set(_BOXY.split("|")), set(_FLAT_TOPPED.split("|"))
    return {
        name: Mounting(kinds.get(name, "any"), name in BUILT_IN, bases.get(name), name in boxy, name in FITTED, name in topped)
        for name in (*kinds, *BUILT_IN, *FITTED)
    }
