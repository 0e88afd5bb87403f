"""Folders of models for benchmarks: what a library offers of each file."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from tasks.candidates.assets import MadeAsset
from tasks.geometry.meshes import load_glb
from tasks.library.folder import library_in
from tasks.library.indexing import IndexConfig
from tasks.library.library import OpenLibrary

if TYPE_CHECKING:
    import trimesh


@dataclasses.dataclass(frozen=True, eq=False)
class ShelvedModel:
    """A model of a folder, as its library offers it."""

    file: str
    library: OpenLibrary

    @property
    def made(self) -> MadeAsset:
        """Its asset with the GLB."""
        return self.library.asset_of(self.file)

    @property
    def stem(self) -> str:
        """Its name without folder and ending."""
        return Path(self.file).stem

    @property
    def category(self) -> str:
        """What it depicts."""
        return self.made.asset.category

    @property
    def extents(self) -> tuple[float, float, float]:
        """Its sides [m]."""
        x, y, z = self.made.asset.extents
        return x, y, z

    def parts(self) -> list[trimesh.Trimesh]:
        """Its canonical parts [m], +Z up."""
        return load_glb(self.made.files[self.made.asset.mesh_blob], self.file)


def models_in(folder: Path | str | None) -> list[ShelvedModel]:
    """The models of a folder by their files' names, each of those that are the same once; none where no folder is named."""
    if folder is None:
        return []
    library = library_in(Path(folder), IndexConfig(), {})
    return [ShelvedModel(file, library) for file in library.search.files]
