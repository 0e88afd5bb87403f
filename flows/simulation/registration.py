"""What gymnasium is told of. Since version 1 it looks for no plugins: who wants an environment imports the package that has it."""

from __future__ import annotations

ENVIRONMENT = "metascenes/ObjectNav-v0"
"""What `gymnasium.make` and `gymnasium.make_vec` call it, once `flows.simulation` is imported; with `flows.simulation:` before it they
import that themselves."""


def register() -> None:
    """Make the environments known to gymnasium. Loads none of them; once is enough, and twice does no harm."""
    import gymnasium

    if ENVIRONMENT not in gymnasium.registry:
        gymnasium.register(
            id=ENVIRONMENT,
            entry_point="flows.simulation.environment:ObjectNavEnv",
            vector_entry_point="flows.simulation.vector:ObjectNavVectorEnv",
        )
