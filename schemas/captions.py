"""Rows of the captions stage: what an object looks like and what it is made of."""

from __future__ import annotations

from schemas.calls import CALL_PATTERN
from schemas.record import INSTANCE_PATTERN, SCENE_PATTERN, column, record


@record("captions", key=("scene_id", "instance_id"), stage="captions")
class Caption:
    """Appearance and physical attributes of an instance (supplementary, Tables A1 and A2)."""

    scene_id: str = column("Scene", pattern=SCENE_PATTERN)
    instance_id: str = column("Instance", pattern=INSTANCE_PATTERN)
    provider: str = column("Who made the caption")
    provider_version: str = column("Version of the provider or model")
    is_fallback: bool = column("True when the configured provider failed and another answered")
    sentence: str = column("One sentence: material, color, shape, category")
    colors: tuple[str, ...] = column("Color words, most frequent first")
    color_shares: tuple[float, ...] = column("Share of the points per color word", minimum=0, maximum=1)
    materials: tuple[str, ...] = column("Material words, most likely first")
    shape: str = column("Shape word from the proportions of the box")
    body_type: str = column("How it behaves", values=("rigid", "cloth", "soft"))
    density_kg_m3: float | None = column(
        "Density of the solid material; missing when a finished dataset states the mass alone", unit="kg/m3", minimum=1, maximum=25000
    )
    solid_fraction: float | None = column(
        "Share of the oriented box that is solid material; missing when a finished dataset states the mass alone", minimum=0.001, maximum=1
    )
    mass_kg: float = column(
        "Mass: density x solid fraction x box volume, within the category's range; or as a finished dataset states it",
        unit="kg",
        minimum=0.001,
    )
    friction: float = column("Coefficient of friction", minimum=0, maximum=2)
    restitution: float = column("Coefficient of restitution", minimum=0, maximum=1)
    attribute_source: str = column(
        "Row of the category table that the physical attributes came from, or the finished dataset or model (`model:`) that states them"
    )
    appearance_call_id: str | None = column("Call of the model that told what it looks like", pattern=CALL_PATTERN)
    physics_call_id: str | None = column("Call of the model that told how it behaves", pattern=CALL_PATTERN)
