"""Rows of the optimization stage: where every asset ends up, how it got there, and whether it stays there."""

from __future__ import annotations

from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record

BODY_PATTERN = r"[0-9]{4,}|floor|ceiling|(wall|inner)_[0-9]{2,}|bracket_[0-9]{4,}"
"""An instance, or a part of the room as exports name it: `floor`, `wall_00`, `inner_00`, or `bracket_0012`, which carries instance 0012."""

AGAINST_PATTERN = r"ceiling|(wall|inner)_[0-9]{2,}"
"""A part of the room that something hangs on or stands against."""

RELATIONS = ("floor", "on", "inside", "wall", "ceiling", "none")
"""How an object can be carried."""

APPLIED = ("pulled_in", "hung", "rested", "kept", "tipped", "laid_down", "relocated", "fallen")
"""Outcomes of steps that moved something: replaying these steps gives the optimized poses."""


@record("placements", key=("scene_id", "instance_id"), stage="optimization")
class Placement:
    """The asset that stands for an instance, its proposed, optimized and settled poses."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    asset_id: str = column("Asset", pattern=r"[0-9a-f]{64}")
    origin: str = column(
        "Who proposed it; imported is a finished dataset that does not say whether a person did, synthesis a model that drew it",
        values=("annotation", "selection", "imported", "synthesis"),
    )
    annotator: str | None = column("Annotator whose answer won")
    annotation_match: str | None = column("How the annotation was matched to the instance", values=("same_box", "box_iou"))
    scale: tuple[float, ...] = column("Scale along the asset's own axes, applied before the pose", length=3, minimum=0.001)
    proposed_pose: tuple[float, ...] = column(
        "Asset to world frame as proposed, 4x4 row by row; the optimized pose where a finished dataset states one pose", unit="m", length=16
    )
    optimized_pose: tuple[float, ...] = column("Asset to world frame after optimization, 4x4 row by row", unit="m", length=16)
    settled_pose: tuple[float, ...] | None = column(
        "Asset to world frame after the certificate's simulated time under gravity in MuJoCo, 4x4 row by row; missing when MuJoCo did not "
        "simulate it",
        unit="m",
        length=16,
    )
    displacement_m: float | None = column(
        "Horizontal distance between the proposed and the optimized pose; missing where a finished dataset states one pose",
        unit="m",
        minimum=0,
    )
    lift_m: float | None = column("Optimized height minus proposed height; missing where a finished dataset states one pose", unit="m")
    method: str = column("Optimization method; imported is a finished dataset's own", values=("paper", "released", "default", "imported"))
    remains: str | None = column(
        "What is still wrong with the optimized pose, by the optimization and by every engine of the table certificates, mujoco_defaults "
        "among them: where an object moves, the engine is named in brackets; missing when nothing is"
    )
    collider_pieces: int | None = column("Convex pieces of the asset; missing where a finished dataset says nothing of them", minimum=1)
    collider_faces: int | None = column("Triangles of these pieces; missing with them", minimum=4)
    collider_early_share: float | None = column(
        "Of rays along the axes from six sides of the unscaled asset, 1.5 cm apart, that meet the asset or stop early beside it, those "
        "that stop at a piece more than 2 cm before the asset, or beside it with no part of it within 2 cm; missing with the pieces, and "
        "where they are this object's alone",
        minimum=0,
        maximum=1,
    )
    collider_miss_share: float | None = column(
        "Of the same rays those that meet the asset, and a piece only more than 1 cm behind it or none; missing with the share above",
        minimum=0,
        maximum=1,
    )
    collider_blob: str | None = column(
        "Convex pieces of this object alone, scaled, in its own frame, GLB with one node each: the asset's, cut back where they were in "
        "neighbors, walls or what carries the object; missing where the asset's own stand for it",
        blob=True,
    )
    collider_cut_share: float | None = column(
        "Of the volume of the asset's pieces what was cut away of them; missing where a finished dataset says nothing of them",
        minimum=0,
        maximum=1,
    )
    collider_distance_m: float | None = column(
        "95 % of the points on the asset's surface lie within this distance of the surface of its pieces; points within 2 cm of another "
        "object's pieces, a wall or the floor do not count; missing where there are no others, or where a finished dataset has no pieces",
        unit="m",
        minimum=0,
    )
    fidelity_loss: float | None = column(
        "How much less the F-score at 5 cm of the asset and the object's scanned points is than where selection, or a person, put it; "
        "missing where the object has no points",
        minimum=0,
        maximum=1,
    )


@record("supports", key=("scene_id", "instance_id"), stage="optimization")
class Support:
    """What carries an instance."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Carried instance", pattern=INSTANCE_PATTERN)
    relation: str = column(
        "How it is carried: 'inside' is a compartment or container of the parent, 'wall' and 'ceiling' are hanging; 'none': nothing, or a "
        "bracket at a wall (bracket_blob)",
        values=RELATIONS,
    )
    parent_id: str | None = column("Carrying instance for 'on' and 'inside'", pattern=INSTANCE_PATTERN)
    against: str | None = column("Part of the room that it hangs on or stands against", pattern=AGAINST_PATTERN)
    gap_m: float = column("Height of the proposed asset's bottom above what carries it; negative when it sinks in", unit="m")
    is_fixed: bool = column(
        "Fastened to the room: it hangs on a wall or ceiling, is built in, or is a fitted kitchen's; all else is free to move"
    )
    is_kept: bool = column("The same object still carries it after the optimization")
    is_inferred: bool = column(
        "The scan does not show what it stands on: a board, plate or base below it is in colliders alone (placements.collider_blob)",
        earlier=False,
    )
    bracket_blob: str | None = column(
        "Convex pieces of a thin board at a wall that carries it, which the scan does not show, world frame, GLB with one node each; "
        "missing where it has none",
        blob=True,
    )


@record("contacts", key=("scene_id", "phase", "instance_a", "body_b"), stage="optimization")
class Contact:
    """An instance and another, or a part of the room, that overlap before or after optimization."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    phase: str = column("Pose that was tested", values=("proposed", "optimized"))
    instance_a: str = column("First instance of the pair, the smaller id", pattern=INSTANCE_PATTERN)
    body_b: str = column("Second instance of the pair, or a part of the room: floor, wall_00, inner_00, bracket_0012", pattern=BODY_PATTERN)
    box_overlap_m3: float = column("Volume of the overlap of the axis-aligned boxes; 0 for parts of the room", unit="m3", minimum=0)
    penetration_m: float = column(
        "Penetration depth of the convex pieces, the deepest pair of pieces; 0 when only the boxes overlap", unit="m", minimum=0
    )
    is_allowed: bool = column("The two may interpenetrate: what is fixed with the room that it is fastened to, or with what else is fixed")


@record("optimization_steps", key=("scene_id", "step"), stage="optimization")
class OptimizationStep:
    """One step of the optimization. Replaying the steps that moved something gives the optimized poses bit for bit."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    step: int = column("Step, 0 is the proposed state; the default method leaves out moves that it took back", minimum=0)
    instance_id: str | None = column("Moved instance, with all it carries; missing for step 0", pattern=INSTANCE_PATTERN)
    dx_m: float = column("Move of the object's origin along x", unit="m")
    dy_m: float = column("Move of the object's origin along y", unit="m")
    dz_m: float = column("Move of the object's origin along z", unit="m")
    turn_x_radians: float = column(
        "Turn about the object's origin before that move: rotation vector in the world frame, along x", unit="rad"
    )
    turn_y_radians: float = column("The same along y", unit="rad")
    turn_z_radians: float = column("The same along z: the yaw where x and y are 0", unit="rad")
    loss: float = column(
        "Collision loss after the move: sum of IoU (paper, equation A1), overlap volume in m3 (released) or penetration depth "
        "in m (default)",
        minimum=0,
    )
    smallest_loss: float = column("Smallest loss so far, this step included, in the unit of the loss", minimum=0)
    outcome: str = column(
        "What became of the move; 'pulled_in', 'hung', 'rested', 'kept', 'tipped', 'laid_down' (a nudge would have thrown it over), "
        "'relocated' and 'fallen' (it failed its certificate, and was put where it came to rest) moved something",
        values=("start", *APPLIED, "reverted", "left_room", "left_support"),
    )


@record("optimizations", key=("scene_id",), stage="optimization")
class Optimization:
    """What the optimization of a scene came to."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    method: str = column("Optimization method", values=("paper", "released", "default"))
    object_count: int = column("Instances for which an asset was placed", minimum=0)
    loss_start: float = column("Loss of the proposed state at rest, in the method's unit", minimum=0)
    loss_final: float = column("Loss of the state that was kept, in the method's unit", minimum=0)
    moves: int = column("Moves that were tried", minimum=0)
    chains: int = column("Chains that were run", minimum=0)
    ended: str = column("Why it ended", values=("zero_loss", "no_move_helps", "out_of_moves", "nothing_to_do"))
    fixed_count: int = column("Instances that are fixed in the certificate: they hang, are built in, or are a fitted kitchen's", minimum=0)
    deep_pairs: int = column("Pairs that penetrate deeper than 2 mm after the optimization, allowed ones left out", minimum=0)
    remains: tuple[str, ...] = column(
        "What the optimization could not put right and what placements.remains has, the instance's id in front; one line each"
    )


@record("certificates", key=("scene_id", "instance_id", "engine"), stage="optimization")
class Certificate:
    """What an independent physics engine says of an instance: put at its optimized pose, left alone under gravity."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    engine: str = column(
        "Physics engine; mujoco is set as exported scenes are, mujoco_defaults has MuJoCo's own friction cone (pyramidal), impratio (1) "
        "and integrator (Euler)",
        values=("mujoco", "mujoco_defaults", "newton"),
    )
    engine_version: str = column(
        "Version of the engine; Newton's names the solver that it ran: with MuJoCo's own, the two engines are no independent opinions"
    )
    simulated_seconds: float = column("Simulated time", unit="s", minimum=0)
    is_fixed: bool = column("It could not move: it hangs on a wall or ceiling, is built in, or is a fitted kitchen's")
    problem: str | None = column("Why the engine could not simulate it; then where it goes is not known, and both verdicts are false")
    displacement_m: float | None = column(
        "Distance between the optimized and the settled place of the asset's origin; missing with a problem", unit="m", minimum=0
    )
    tilt_radians: float | None = column(
        "Angle between the upright axes before and after; turning about that axis counts neither here nor in the verdicts; missing with "
        "a problem",
        unit="rad",
        minimum=0,
    )
    start_penetration_m: float | None = column(
        "Deepest penetration with anything at the optimized pose, by the engine; missing with a problem", unit="m", minimum=0
    )
    is_stable_1cm: bool = column("The asset's origin moved by no more than 1 cm, and it tilted by no more than 5 degrees")
    is_stable_5cm: bool = column("The asset's origin moved by no more than 5 cm, and it tilted by no more than 5 degrees")
    nudged_displacement_m: float | None = column(
        "Greatest distance between the optimized and the settled place of the asset's origin after any of four nudges: all free objects at "
        "0.05 m/s, unless configured otherwise, along +x, -x, +y or -y; missing with a problem, or without nudges",
        unit="m",
        minimum=0,
    )
    nudged_tilt_radians: float | None = column(
        "Greatest tilt after any of these nudges; missing with a problem, or without nudges", unit="rad", minimum=0
    )
    is_stable_nudged: bool | None = column(
        "After every nudge it was within 1 cm and 5 degrees: it does not merely balance; missing without nudges"
    )
    settled_pose: tuple[float, ...] | None = column(
        "Asset to world frame at the end, 4x4 row by row; missing with a problem", unit="m", length=16
    )
    mass_kg: float = column("Mass; 0 when it is not known", unit="kg", minimum=0)
    solid_volume_m3: float = column("Volume of the union of the convex pieces; 0 when they enclose none", unit="m3", minimum=0)
    density_kg_m3: float = column("Mass over solid volume; 0 when either is 0", unit="kg/m3", minimum=0)
    density_low_kg_m3: float | None = column(
        "1 % of the least density of its lightest material, 0.4 % for fabric and foliage: objects are hollow where their pieces are solid; "
        "missing when no material is known",
        unit="kg/m3",
        minimum=0,
    )
    density_high_kg_m3: float | None = column(
        "Greatest density of its densest material; missing when no material is known", unit="kg/m3", minimum=0
    )
    is_density_plausible: bool | None = column("The density lies between those bounds; missing when it or they are not known")
