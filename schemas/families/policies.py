"""Built-in policies: who can act in episodes without any model. The objects are in `tasks.evaluation.policies`."""

from __future__ import annotations

POLICIES = ("expert", "random")
