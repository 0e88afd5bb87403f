"""Whether a USD scene can be simulated as it is: USD's own validators, and rules that they do not know.

Works on anybody's file. What only makes a scene less portable, or is a choice of this project, is a warning there, and
so is what USD leaves to engines (an inertia that is not stated, a decomposition) in files that this project did not write.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import check_file
from tasks.composition import refuse_large_stage
from tasks.exports.findings import Finding
from tasks.exports.usd import body_rules, deformable_rules, stage_rules, visual_rules
from tasks.exports.usd.package import check_package
from tasks.exports.usd.prims import traverse

RULES: dict[str, str] = {
    "stage_opens": "the file opens as a USD stage",
    "package": "a .usdz is as its specification says: stored, aligned to 64 bytes, its first file a layer",
    "usd_validation": "USD's own validators report no error",
    "default_prim": "a default prim is named and exists",
    "units": "metres and kilograms are stated, one unit each",
    "up_axis": "+Z is stated to be up",
    "layer_units": "layers agree with the stage about units and the upward axis, which USD does not convert",
    "closed_paths": "every file that is named is named by a relative path inside the scene's folder, and is there",
    "model_hierarchy": "models lie below groups and assemblies only, so that they are found",
    "physics_scene": "there is one physics scene whose gravity points down",
    "ground": "what moves has something below it that stays in place",
    "joints": "joints hold two bodies that exist, or one to the world, and articulations have joints",
    "point_instancer": "no body or collider is scattered by a point instancer, where engines do not see it",
    "nested_bodies": "no rigid body lies inside another one",
    "one_body": "a model is one rigid body, unless joints hold several together",
    "rigid_pose": "bodies and colliders are moved and turned, by unit quaternions, but not scaled, sheared or mirrored",
    "animated_body": "no body that is moved by forces has an animated pose",
    "finite_geometry": "positions are finite and triangles name vertices that exist",
    "extents": "extents that are stated hold what they are stated of",
    "collider": "every rigid body has a collider, and hulls have a volume",
    "triangle_collider": "no moving body collides with its raw triangles",
    "explicit_hulls": "colliders are convex as they are, so no engine has to decompose them",
    "hull_limits": "hulls have no more vertices and faces than PhysX takes: it cooks smaller ones otherwise",
    "guides": "colliders are not drawn beside what is meant to be seen",
    "mass": "every moving body has a mass above zero",
    "inertia": "every moving body has an inertia that a solid can have",
    "center_of_mass": "the center of mass lies inside the box of the body's colliders",
    "support_plane": "colliders do not reach below what is seen of their object, but for supports that are inferred",
    "protrusion": "colliders do not reach far out of what is seen of their object",
    "start_overlap": "no moving body starts inside another object",
    "physics_material": "every collider has friction and restitution within bounds, bound on itself, where all readers see it",
    "depenetration": "what moves says how fast PhysX may push it out of others: at its default what touches is thrown",
    "deformable": "a deformable body has one simulation mesh, on it or right below it",
    "deformable_body": "nothing in a deformable body is a rigid body",
    "deformable_mass": "a deformable body has a mass above zero",
    "tetrahedra": "no tetrahedron of a simulation mesh is inverted, and their surface is closed",
    "sheet": "at most two triangles of a simulation mesh meet in an edge, and none is flat",
    "deformable_material": "a deformable body has an elasticity that a stable solid can have",
    "visual": "every body can be seen, where it collides",
    "viewing": "a scene has lights, and a camera among what is to be seen",
    "labels": "every body says what it is, on its root",
}
"""Every rule, and what holds when it passes."""

_NOT_HERE = re.compile(r"^MissingSourceTypeInRegistry .*'mdl'|^UnresolvableDependency [^/]*\.mdl'")
"""What USD says of Omniverse's own materials: that it cannot draw them here."""

VARIANT_SET = "physics"
"""The variant set whose other variants are checked too: what is behind it is another scene to an engine."""


def check_usd(path: Path) -> list[Finding]:
    """Everything that is wrong with a USD scene, sorted; empty for one that can be simulated as it is.

    Objects with a variant set `physics` are checked in each of its variants; what is found only there says so.
    """
    from pxr import Tf, Usd

    try:
        check_file(path, path.name, BUDGET.scene_bytes)
    except (InputError, OSError) as error:
        return [Finding("stage_opens", path.name, _line(str(error), path))]
    findings = list(check_package(path))
    try:
        refuse_large_stage(path)
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        return [*findings, Finding("stage_opens", path.name, _line(_words(error), path))]
    except InputError as error:
        return [*findings, Finding("budget", path.name, _line(str(error), path))]
    findings += _checked(stage, path, _CHECKS)
    known = {(finding.rule, finding.where, finding.message) for finding in findings}
    for variant, part in _variants(stage):
        for finding in _checked(part, path, _IN_VARIANTS):
            if (finding.rule, finding.where, finding.message) not in known:
                message = f"{finding.message} (in variant {VARIANT_SET}={variant})"
                findings.append(Finding(finding.rule, finding.where, message, finding.is_error))
    return sorted(set(findings))


def _checked(stage: Any, path: Path, checks: tuple[Callable[[Any, Path], Iterator[Finding]], ...]) -> list[Finding]:
    """What checks find in a stage."""
    from pxr import Tf

    findings: list[Finding] = []
    for check in checks:
        try:
            findings += check(stage, path)
        except (Tf.ErrorException, UnicodeDecodeError) as error:  # a layer behind a reference is broken: read only when needed
            findings.append(Finding("stage_opens", path.name, _line(_words(error), path)))
    return findings


def _variants(stage: Any) -> Iterator[tuple[str, Any]]:
    """Variants that are not selected, with the part of the stage that has them, in which they are."""
    from pxr import Sdf, Usd

    sets = {prim.GetPath(): prim.GetVariantSets().GetVariantSet(VARIANT_SET) for prim in traverse(stage) if not prim.IsInstanceProxy()}
    names: dict[str, list[Any]] = {}
    for place, variants in sets.items():
        for name in variants.GetVariantNames():
            if name != variants.GetVariantSelection():
                names.setdefault(name, []).append(place)
    for name in sorted(names):
        session = Sdf.Layer.CreateAnonymous(".usda")
        for place in names[name]:
            Sdf.CreatePrimInLayer(session, place).variantSelections[VARIANT_SET] = name
        mask = Usd.StagePopulationMask(names[name])
        yield name, Usd.Stage.OpenMasked(stage.GetRootLayer(), session, mask)


def _words(error: Exception) -> str:
    """What an exception says; USD quotes files as they are, whether that is text or not."""
    try:
        return str(error)
    except UnicodeDecodeError as broken:
        return broken.object.decode(errors="backslashreplace")


def _line(text: str, path: Path) -> str:
    """A message of USD's in one line, with files named from the scene's folder, so it is the same wherever that lies."""
    plain = text.replace(f"{path.parent.resolve()}/", "").replace(f"{path.parent}/", "")
    plain = re.sub(r"anon:0x[0-9a-f]+(:[^@>\s]*)?", "anonymous", plain)  # an address in memory is another one every time
    return re.sub(r"Error in '\S+' at line \d+ in file \S+ : ", "", " ".join(plain.split()))[:300]


def _validators(stage: Any, path: Path) -> Iterator[Finding]:
    """USD's own validators."""
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    for error in UsdValidation.ValidationContext(validators).Validate(stage):
        kind = error.GetType()
        text = _line(error.GetMessage(), path)
        serious = kind == UsdValidation.ValidationErrorType.Error and not _NOT_HERE.search(f"{error.GetName()} {text}")
        sites = [site.GetPrim().GetPath().pathString for site in error.GetSites() if site.IsPrim()]
        yield Finding("usd_validation", sites[0] if sites else path.name, f"{error.GetName()}: {text}", serious)


_IN_VARIANTS: tuple[Callable[[Any, Path], Iterator[Finding]], ...] = (
    _validators, body_rules.nesting, body_rules.one_body, body_rules.poses, body_rules.geometry,
    body_rules.colliders, body_rules.masses, visual_rules.boxes, body_rules.materials, body_rules.depenetration, body_rules.labels,
    deformable_rules.deformables,
)  # fmt: skip
"""What is looked at again in variants: objects, not the file."""

_CHECKS: tuple[Callable[[Any, Path], Iterator[Finding]], ...] = (
    *_IN_VARIANTS, stage_rules.metadata, stage_rules.layers, stage_rules.paths, stage_rules.hierarchy,
    stage_rules.physics_scene, stage_rules.ground, stage_rules.joints, stage_rules.point_instancers,
    stage_rules.viewing,    body_rules.animation, body_rules.overlaps,
)  # fmt: skip
