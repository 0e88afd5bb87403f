"""What gymnasium is told of: it calls `register` when it is imported, by the entry point `gymnasium.envs` of this package."""

from __future__ import annotations

NAMESPACE, NAME = "metascenes", "ObjectNav-v0"

ENVIRONMENT = f"{NAMESPACE}/{NAME}"
"""What `gymnasium.make` and `gymnasium.make_vec` call it."""


def register() -> None:
    """Make the environments known to gymnasium. Loads none of them; once is enough, and twice does no harm."""
    import gymnasium

    if ENVIRONMENT not in gymnasium.registry:
        gymnasium.register(
            id=ENVIRONMENT,
            entry_point="flows.simulation.environment:ObjectNavEnv",
            vector_entry_point="flows.simulation.vector:ObjectNavVectorEnv",
        )
