"""The built-in policies."""

from __future__ import annotations

from schemas.families.policies import POLICIES as NAMES
from tasks.evaluation.policy import Policy
from tasks.families import members

POLICIES = members("tasks.evaluation.policies", NAMES, Policy)
