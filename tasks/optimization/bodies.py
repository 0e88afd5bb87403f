"""Bodies: the solids of a room with mass, friction and material from the captions."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from schemas.captions import Caption
from tasks.optimization.interior import Interior
from tasks.optimization.solids import RigidBody, mass_properties_of
from tasks.settings import Config, NonNegative, Positive


@dataclasses.dataclass(frozen=True)
class BodyConfig(Config):
    """What is taken of an object without a caption."""

    density_kg_m3: Positive = 300.0  # light wood with hollows
    friction: NonNegative = 0.5  # wood on wood


def bodies_of(interior: Interior, captions: Sequence[Caption], config: BodyConfig) -> tuple[list[RigidBody], list[str]]:
    """The objects of a room as bodies, in its order, and what had to be assumed, a line each."""
    known = {caption.instance_id: caption for caption in captions}
    bodies, notes = [], []
    for obj, solid, fixed in zip(interior.objects, interior.solids, interior.fixed.tolist(), strict=True):
        caption = known.get(obj.instance_id)
        if caption is None:
            notes.append(f"{obj.instance_id}: no caption; mass from a density of {config.density_kg_m3:g} kg/m3")
            mass = max(config.density_kg_m3 * mass_properties_of(solid).volume, 0.001)
            bodies.append(RigidBody(solid, mass, config.friction, (), fixed))
        else:
            bodies.append(RigidBody(solid, caption.mass_kg, caption.friction, caption.materials, fixed))
    return bodies, notes
