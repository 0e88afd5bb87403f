"""Bodies: the solids of a room with mass, friction and material from the captions."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from schemas.captions import Caption
from tasks.optimization.interior import Interior
from tasks.optimization.solids import Body, mass_properties_of


@dataclasses.dataclass(frozen=True)
class BodyConfig:
    """What is taken of a thing without a caption."""

    density_kg_m3: float = 300.0  # light wood with hollows
    friction: float = 0.5  # wood on wood

    def __post_init__(self) -> None:
        if not 0 < self.density_kg_m3 < float("inf") or not 0 <= self.friction < float("inf"):
            raise ValueError("density_kg_m3: must be above 0; friction: must be at least 0")


def bodies_of(interior: Interior, captions: Sequence[Caption], config: BodyConfig) -> tuple[list[Body], list[str]]:
    """The things of a room as bodies, in its order, and what had to be assumed, a line each."""
    known = {caption.instance_id: caption for caption in captions}
    bodies, said = [], []
    for thing, solid, fixed in zip(interior.things, interior.solids, interior.fixed.tolist(), strict=True):
        caption = known.get(thing.instance_id)
        if caption is None:
            said.append(f"{thing.instance_id}: no caption; mass from a density of {config.density_kg_m3:g} kg/m3")
            mass = max(config.density_kg_m3 * mass_properties_of(solid).volume, 0.001)
            bodies.append(Body(solid, mass, config.friction, (), fixed))
        else:
            bodies.append(Body(solid, caption.mass_kg, caption.friction, caption.materials, fixed))
    return bodies, said
