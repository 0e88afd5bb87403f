"""The learned systems."""

from __future__ import annotations

from schemas.families.learned_systems import LEARNED_SYSTEMS
from tasks.families import members
from tasks.training.system import LearnedSystem

SYSTEMS = members("tasks.training.systems", LEARNED_SYSTEMS, LearnedSystem)
