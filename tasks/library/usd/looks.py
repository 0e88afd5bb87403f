"""Colors and textures of USD prims: display colors, preview surfaces, and the base colors of NVIDIA's material library."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.library.usd.shapes import Polygons, first, numbers

Array = NDArray[np.float64]
Color = tuple[float, float, float]

COLORS = ("diffuseColor", "diffuse_color_constant", "base_color")
EMISSION, BLACK = "emissiveColor", (0.0, 0.0, 0.0)
TEXTURES = ("diffuse_texture", "base_color_texture")
"""Inputs of materials that hold a base color; UsdPreviewSurface's, and those of OmniPBR, which states pictures beside it."""


class BaseColor(NamedTuple):
    """Appearance of a prim. color: linear, 0 to 1, the factor of an image if there is one. file: the image.

    is_linear: the image's bytes are linear values, as `sourceColorSpace` = `raw` states.
    """

    color: Color | None = None
    file: Path | None = None
    is_linear: bool = False


def look_of(prim: Any) -> BaseColor:
    """The base color of the material that is bound to a prim; the light that it emits if it reflects none."""
    from pxr import UsdShade

    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
    for source in (material.ComputeSurfaceSource(), material.ComputeSurfaceSource("mdl")) if material else ():
        shader = source[0]
        if not shader:
            continue
        inputs = [_input(shader, name) for name in COLORS]
        light = _input(shader, EMISSION)
        if light != BaseColor() and light.color != BLACK and [given for given in inputs if given != BaseColor()] == [BaseColor(BLACK)]:
            return light
        color = next((given.color for given in inputs if given.color), None)
        file = next((given.file for given in inputs if given.file), None)
        is_linear = any(given.is_linear for given in inputs)
        for name in TEXTURES:
            file = file or _picture(shader.GetInput(name))
        if color or file:
            return BaseColor(color, file, is_linear)
    return BaseColor()


def is_see_through(prim: Any) -> bool:
    """True if the preview surface that is bound to a prim, or its display opacity, lets light through."""
    from pxr import UsdGeom, UsdShade

    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayOpacity")
    shown = numbers(primvar.ComputeFlattened(), np.float64, 1) if primvar and primvar.HasValue() else np.ones((1, 1))
    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
    shader = material.ComputeSurfaceSource()[0] if material else None
    given = shader.GetInput("opacity") if shader else None
    if not given:
        return bool((shown < 1.0).any())
    value = numbers(first(given.GetAttr()), np.float64, 1)
    return given.HasConnectedSource() or bool((value < 1.0).any())


def _input(shader: Any, name: str) -> BaseColor:
    """A color input: its value, or the image and scale of a texture reader behind it."""
    from pxr import UsdShade

    given = shader.GetInput(name)
    if not given:
        return BaseColor()
    for attribute in UsdShade.Utils.GetValueProducingAttributes(given):
        behind = UsdShade.Shader(attribute.GetPrim())
        if behind and behind.GetIdAttr().Get() == "UsdUVTexture":
            scale, space = behind.GetInput("scale"), behind.GetInput("sourceColorSpace")
            is_scaled = bool(scale) and scale.GetTypeName().type.typeName == "GfVec4f"
            factor = numbers(first(scale.GetAttr()) if is_scaled else None, np.float64, 4)
            is_factor = len(factor) == 1 and np.isfinite(factor).all() and (factor[0, :3] != 1.0).any()
            color = _color(factor[0, :3]) if is_factor else None
            is_linear = bool(space) and str(first(space.GetAttr())) == "raw"
            return BaseColor(color, _picture(behind.GetInput("file")), is_linear)
        is_color = attribute.GetTypeName().scalarType.type.typeName == "GfVec3f"
        value = numbers(first(attribute) if is_color else None, np.float64, 3)
        if len(value) == 1 and np.isfinite(value).all():
            return BaseColor(_color(value[0]))
    return BaseColor()


def _color(values: Array) -> Color:
    """Three numbers as a tuple, 0 to 1."""
    r, g, b = (min(max(float(value), 0.0), 1.0) for value in values)
    return r, g, b


def _picture(given: Any) -> Path | None:
    """The picture that an asset input names, where the stage finds it."""
    value = first(given.GetAttr()) if given else None
    place = getattr(value, "resolvedPath", "") or ""
    return Path(place) if place else None


def uv_of(prim: Any, shape: Polygons) -> Array | None:
    """Texture coordinates of every corner, origin at the lower left, shape (c, 2); None for what has none."""
    from pxr import UsdGeom

    for primvar in UsdGeom.PrimvarsAPI(prim).FindPrimvarsWithInheritance():
        if str(primvar.GetTypeName()) in ("texCoord2f[]", "float2[]", "texCoord2d[]", "texCoord2h[]"):
            values = _of_corners(primvar, shape, 2)
            if values is not None and np.isfinite(values).all():
                return values
    return None


def display_colors(prim: Any, shape: Polygons) -> Array | None:
    """Linear display color of every corner, shape (c, 3); None for what has none."""
    from pxr import UsdGeom

    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
    return _of_corners(primvar, shape, 3) if primvar and primvar.HasValue() else None


def _of_corners(primvar: Any, shape: Polygons, width: int) -> Array | None:
    """The values of a primvar for every corner, shape (c, width).

    Raises:
        InputError: it has fewer values than its interpolation asks for.
    """
    from pxr import Usd

    values = numbers(primvar.ComputeFlattened(Usd.TimeCode.EarliestTime()), np.float64, width)
    order = {
        "constant": np.zeros(len(shape.point_of), dtype=np.int64), "uniform": shape.face_of, "vertex": shape.point_of,
        "varying": shape.point_of, "faceVarying": np.arange(len(shape.point_of)),
    }.get(str(primvar.GetInterpolation()))  # fmt: skip
    if order is None or not len(values):
        return None
    if len(order) and order.max() >= len(values):
        raise InputError("", str(primvar.GetAttr().GetPath()), f"has {len(values)} values, fewer than it is asked for", "export it again")
    return np.asarray(values[order], dtype=np.float64)
