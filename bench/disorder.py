"""Replicas in disorder: objects lifted and tilted, so that there is something to fall, and certificates of them as they are."""

from __future__ import annotations

import dataclasses

import numpy as np

from schemas.optimization import Certificate
from tasks.exports.bodies import Replica
from tasks.geometry.transforms import rotation_of, translation
from tasks.optimization.certificates import CertificateConfig, certificate_rows, certify
from tasks.optimization.contacts import Colliders
from tasks.optimization.solids import ConvexParts, RigidBody, shell_solids

LIFT_M, TILT = (0.02, 0.12), (0.2, 0.7)
"""Least and most that objects are lifted [m], and tilted [rad]."""

SHARE = 4
"""Of how many free objects one is lifted; every other one of those is tilted, too."""

NEW_OVERLAP_M = 1e-4
"""Deeper than this nothing is moved into anything [m]: what is pushed out of an overlap flies by rounding errors, in any engine."""


LEFT_ALONE = CertificateConfig(mujoco_defaults=False, nudge_m_s=0.0)
"""One engine, and no nudges."""


def certificates_of(replica: Replica) -> list[Certificate]:
    """MuJoCo's certificates of the bodies of a replica where they are."""
    bodies = [RigidBody(ConvexParts(b.instance_id, b.shape.hulls), b.mass_kg, b.friction, (), b.is_fixed) for b in replica.bodies]
    poses = np.array([body.pose for body in replica.bodies]).reshape(-1, 4, 4)
    return certificate_rows(replica.scene_id, certify(bodies, poses, shell_solids(replica.room), LEFT_ALONE))


def in_disorder(replica: Replica, rng: np.random.Generator) -> Replica:
    """The replica with a share of its free objects lifted, or lifted and tilted, where there is room for it."""
    bodies = list(replica.bodies)
    colliders = Colliders([ConvexParts(body.instance_id, body.shape.hulls) for body in bodies], shell_solids(replica.room))

    def depths() -> dict[tuple[str, str], float]:
        contacts = colliders.penetrations(np.array([body.pose for body in bodies]))
        return {(contact.a, contact.b): contact.depth_m for contact in contacts}

    known = depths()
    wanted = 0
    for count, number in enumerate(i for i, body in enumerate(bodies) if not body.is_fixed):
        wanted += count % SHARE == 0
        body, tilt = bodies[number], np.eye(4)
        if rng.integers(2):
            tilt[:3, :3] = rotation_of([float(rng.uniform(*TILT)), 0.0, 0.0])
        pose = translation([0.0, 0.0, float(rng.uniform(*LIFT_M))]) @ body.pose @ tilt
        if not wanted:
            continue
        bodies[number] = dataclasses.replace(body, pose=pose)
        now = depths()
        if any(depth > known.get(pair, 0.0) + NEW_OVERLAP_M for pair, depth in now.items()):
            bodies[number] = body  # the next one takes its turn
        else:
            known, wanted = now, wanted - 1
    return dataclasses.replace(replica, bodies=tuple(bodies))
