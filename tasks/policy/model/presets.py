"""Policies by name: the one that trains here, what it is held against, and the published size."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from tasks.policy.model.config import Paper, PolicyModel, Small

PRESETS: Mapping[str, PolicyModel] = MappingProxyType(
    {"small": Small(), "blind": Small(blind=True), "goalless": Small(goalless=True), "paper": Paper()}
)
"""By name; `blind` and `goalless` are the small one without pictures and without goals."""
