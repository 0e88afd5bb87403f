"""Policies by name: the one that trains here, what it is held against, and the published size."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from tasks.policy.model.config import PaperPolicy, PolicyModel, SmallPolicy

PRESETS: Mapping[str, PolicyModel] = MappingProxyType(
    {"small": SmallPolicy(), "blind": SmallPolicy(blind=True), "goalless": SmallPolicy(goalless=True), "paper": PaperPolicy()}
)
"""By name; `blind` and `goalless` are the small one without pictures and without goals."""
