"""Policies by name: the one that trains here, what it is held against, and the published size."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from tasks.policy.model.config import OwnEyes, PaperPolicy, PolicyModel, SmallPolicy

PRESETS: Mapping[str, PolicyModel] = MappingProxyType(
    {
        "small": SmallPolicy(), "sensing": SmallPolicy(eyes=OwnEyes(depth=True, goal=True)), "blind": SmallPolicy(blind=True),
        "goalless": SmallPolicy(eyes=OwnEyes(depth=True), goalless=True), "paper": PaperPolicy(),
    }
)  # fmt: skip
"""By name. `sensing` also has what the simulator's depth and semantic cameras say; `blind` is the small one without pictures, `goalless`
`sensing` without a goal."""
