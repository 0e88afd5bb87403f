"""Captions: what an object looks like, what it is made of, how it behaves.

The classical provider names colors and materials from the instance's points and takes physical attributes from a
sourced category table. A learned provider is a further member of `CaptionProvider`, matched by its type in `run`.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from schemas.captions import Caption
from schemas.capture import Instance
from schemas.errors import InputError
from tasks.captions.colors import ColorNames, name_colors, roughness
from tasks.captions.materials import likely_materials, rank_materials
from tasks.captions.physics import attributes, implausible, mass
from tasks.captions.sentences import compose, shape_word
from tasks.geometry.boxes import grown_box
from tasks.geometry.meshes import read_points
from tasks.settings import Config, Whole
from tasks.stage import Context, Outcome, Stage


@dataclasses.dataclass(frozen=True)
class ClassicalCaptions(Config):
    """Colors and materials from the points, physical attributes from the category table. Needs no model."""

    min_points: Whole = 20  # fewer give a color word that a few bleeding pixels decide; the caption is made but reported
    version: str = "1"  # goes up when the same points would get other words


CaptionProvider = ClassicalCaptions
"""Whoever can make captions: a union of frozen configs."""


@dataclasses.dataclass(frozen=True)
class CaptionsConfig(Config):
    """Who words captions."""

    provider: CaptionProvider = ClassicalCaptions()  # runs anywhere; learned ones need weights or an endpoint


def run(*, instances: list[Instance], context: Context, config: CaptionsConfig) -> Outcome:
    """A caption of every instance that is no structure."""
    captions: list[Caption] = []
    degradations: list[str] = []
    for instance in sorted(instances, key=lambda row: row.instance_id):
        if instance.is_structure:
            continue
        match config.provider:
            case ClassicalCaptions() as provider:
                caption, problems = _describe(instance, context, provider)
        captions.append(caption)
        degradations += [f"{instance.instance_id} {instance.category}: {problem}" for problem in problems]
    return Outcome(captions=captions, degradations=degradations)


def _describe(instance: Instance, context: Context, provider: ClassicalCaptions) -> tuple[Caption, list[str]]:
    """The classical caption of an instance, and what could not be told well."""
    problems: list[str] = []
    names, rough = name_colors([]), 0.0
    try:
        points, colors = _points(instance, context)
        names, rough = name_colors(colors), roughness(points, colors)
        if len(colors) < provider.min_points:
            problems.append(f"{len(colors)} points are too few for a color that can be trusted")
    except InputError as error:
        problems.append(f"no color: {error}")
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
        provider="classical",
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
    )
    return caption, problems


def _points(instance: Instance, context: Context) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points [m] and colors of an instance."""
    if instance.points_blob not in context.blobs:
        raise InputError(instance.points_blob, "points_blob", "is not among the blobs", "run the capture stage again")
    return read_points(context.blobs[instance.points_blob], instance.points_blob)


STAGE = Stage(name="captions", reads=("instances",), writes=("captions",), config=CaptionsConfig, run=run)

__all__ = ["STAGE", "CaptionProvider", "CaptionsConfig", "ClassicalCaptions", "ColorNames", "run"]
