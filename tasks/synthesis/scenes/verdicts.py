"""Whether objects would stay where they were drawn, before anything is put right: asked of the engine that certifies what was."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from schemas.candidates import Asset
from schemas.captions import Caption
from schemas.capture import Instance, Shell
from schemas.selection import Selection
from tasks.optimization import OptimizationConfig
from tasks.optimization.bodies import bodies_of
from tasks.optimization.certificates import certify
from tasks.optimization.interior import furnish
from tasks.optimization.proposals import propose
from tasks.stage import Context


def stable_as_drawn(
    instances: Sequence[Instance], captions: Sequence[Caption], selections: Sequence[Selection], shell: Shell, assets: Sequence[Asset],
    context: Context, config: OptimizationConfig,
) -> dict[str, bool | None]:  # fmt: skip
    """By instance, whether MuJoCo leaves it within 1 cm and 5 degrees; None for what it refuses. Nothing is nudged."""
    known = {asset.asset_id: asset for asset in assets}
    proposals, _ = propose(instances, selections, (), known)
    interior, _ = furnish(proposals, known, context.blobs, shell, config.supports, config.pieces, context.caches)
    bodies, _ = bodies_of(interior, captions, config.bodies)
    newton = dataclasses.replace(config.certificate.newton, python="")
    alone = dataclasses.replace(config.certificate, newton=newton, mujoco_defaults=False, nudge_m_s=0.0)
    certified = certify(bodies, interior.poses, interior.shell, alone)
    return {item.name: None if item.problem is not None else item.is_stable_1cm for item in certified}
