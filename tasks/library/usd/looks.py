"""Colors and textures of USD prims: display colors, preview surfaces, and the base colors of NVIDIA's material library."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InputError
from tasks.library.usd.shapes import Polygons, first, numbers

Array = NDArray[np.float64]
Color = tuple[float, float, float]

COLORS = ("diffuseColor", "diffuse_color_constant", "base_color")
TEXTURES = ("diffuse_texture", "base_color_texture")
"""Inputs of materials that hold a base color; UsdPreviewSurface's, and those of OmniPBR, which states pictures beside it."""


def look_of(prim: Any) -> tuple[Color | None, Path | None]:
    """Linear base color in 0..1 and picture of the material that is bound to a prim, None where it has none."""
    from pxr import UsdShade

    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
    for source in (material.ComputeSurfaceSource(), material.ComputeSurfaceSource("mdl")) if material else ():
        shader = source[0]
        if not shader:
            continue
        color, file = None, None
        for name in COLORS:
            shown, picture = _input(shader, name)
            color, file = color or shown, file or picture
        for name in TEXTURES:
            file = file or _picture(shader.GetInput(name))
        if color or file:
            return color, file
    return None, None


def _input(shader: Any, name: str) -> tuple[Color | None, Path | None]:
    """A color input: its value, or the picture that a texture reader behind it reads."""
    from pxr import UsdShade

    given = shader.GetInput(name)
    if not given:
        return None, None
    for attribute in UsdShade.Utils.GetValueProducingAttributes(given):
        behind = UsdShade.Shader(attribute.GetPrim())
        if behind and behind.GetIdAttr().Get() == "UsdUVTexture":
            return None, _picture(behind.GetInput("file"))
        is_color = attribute.GetTypeName().scalarType.type.typeName == "GfVec3f"
        value = numbers(first(attribute) if is_color else None, np.float64, 3)
        if len(value) == 1 and np.isfinite(value).all():
            r, g, b = (float(v) for v in value[0])
            return (r, g, b), None
    return None, None


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
