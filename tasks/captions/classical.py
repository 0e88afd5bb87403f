"""The classical caption: colors and materials from an instance's points, physical attributes from the category table."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from schemas.captions import Caption
from schemas.capture import Instance
from schemas.errors import InputError
from tasks.captions.colors import name_colors, roughness
from tasks.captions.materials import likely_materials, rank_materials
from tasks.captions.physics import attributes, implausible, mass
from tasks.captions.sentences import compose, shape_word
from tasks.geometry.boxes import grown_box
from tasks.geometry.meshes import read_points
from tasks.settings import Config, Whole
from tasks.stage import Context


@dataclasses.dataclass(frozen=True)
class ClassicalCaptions(Config):
    """Colors and materials from the points, physical attributes from the category table. Needs no model."""

    kind: ClassVar[str] = "classical"
    min_points: Whole = 20  # fewer give a color word that a few bleeding pixels decide; the caption is made but reported
    version: str = "1"  # goes up when the same points would get other words


def described(instance: Instance, context: Context, provider: ClassicalCaptions) -> tuple[Caption, list[str], list[str]]:
    """The classical caption of an instance, and what could not be told well of its looks, and of its physical attributes."""
    unseen: list[str] = []
    problems: list[str] = []
    names, rough = name_colors([]), 0.0
    try:
        points, colors = _points(instance, context)
        names, rough = name_colors(colors), roughness(points, colors)
        if len(colors) < provider.min_points:
            unseen.append(f"{len(colors)} points are too few for a color that can be trusted")
    except InputError as error:
        unseen.append(f"no color: {error}")
    size = tuple(grown_box(instance.box_pose, instance.box_size, instance.hidden_m)[1].tolist())
    row = attributes(instance.category, instance.nyu40_label, size)
    ranked = likely_materials(rank_materials(row, names, rough))
    weight = mass(row, ranked[0], size)
    if weight.problem:
        problems.append(weight.problem)
    if ":" in row.name:
        problems.append(f"category is not in the table; attributes of {row.name} taken")
        doubt = implausible(row.body_type, weight.mass_kg, row.restitution, size)
        problems += [doubt] if doubt else []
    shape = shape_word(size)
    caption = Caption(
        scene_id=context.scene_id,
        instance_id=instance.instance_id,
        provider=ClassicalCaptions.kind,
        provider_version=provider.version,
        is_fallback=False,
        sentence=compose(instance.category, names.words, names.shares, ranked[0], shape, size),
        colors=names.words,
        color_shares=names.shares,
        materials=ranked,
        shape=shape,
        body_type=row.body_type,
        density_kg_m3=weight.density_kg_m3,
        solid_fraction=weight.solid_fraction,
        mass_kg=weight.mass_kg,
        friction=row.friction,
        restitution=row.restitution,
        attribute_source=row.name,
        appearance_call_id=None,
        physics_call_id=None,
    )
    return caption, unseen, problems


def _points(instance: Instance, context: Context) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points [m] and colors of an instance."""
    if instance.points_blob not in context.blobs:
        raise InputError(instance.points_blob, "points_blob", "is not among the blobs", "run the capture stage again")
    return read_points(context.blobs[instance.points_blob], instance.points_blob)
