"""Rows of the indexing stage: libraries of models, what is in them, and which files were refused."""

from __future__ import annotations

from schemas.record import column, record

LIBRARY_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]*"
HASH = r"[0-9a-f]{64}"
KNOWN = ("file", "metadata", "plausibility", "assumed")


@record("libraries", key=("library",), stage="indexing", grain="library")
class IndexedLibrary:
    """A library of models that candidates are taken from."""

    library: str = column("Library", pattern=LIBRARY_PATTERN)
    content: str = column("Hash of all that retrieval takes from it: what is searched, and the assets", pattern=HASH)
    weights: str | None = column("Hash of the CLIP or SigLIP that its vectors are of; null where it has none", pattern=HASH)
    model_count: int = column("Models", minimum=0)
    duplicate_count: int = column("Models that hold what another one holds", minimum=0)
    refused_count: int = column("Files that were refused", minimum=0)
    search_blob: str = column("What is searched, as arrays", blob=True)
    notes: tuple[str, ...] = column("What of the folder and its catalogs could not be used, a line each")


@record("library_models", key=("library", "file"), stage="indexing", grain="library")
class LibraryModel:
    """A model of a library, with its asset: all that is needed to offer it, wherever the folder is by now."""

    library: str = column("Library", pattern=LIBRARY_PATTERN)
    file: str = column("File, relative to the library's folder")
    content: str = column("Hash of the file and of all that it draws on", pattern=HASH)
    format: str = column("Format of the file, as its reader is called")
    unit_m: float = column("Metres per unit of the file", unit="m", minimum=0)
    unit_known: str = column("How the unit is known", values=KNOWN)
    up: str = column("Axis of the file that points up", values=("y", "z"))
    up_known: str = column("How the up axis is known", values=KNOWN)
    front: str | None = column("Axis of the file that shows the front, such as +x; null where nobody says")
    category: str = column("What it depicts, in the project's words where they have one")
    category_known: str = column("What told the category: lvis, tags, name, categories, product_type, index, or the file name")
    name: str = column("Name")
    license: str = column("License, SPDX identifier where there is one; unknown where nobody says")
    is_noncommercial: bool = column("The license allows no commercial use")
    author: str | None = column("Author, where one is known")
    source_url: str | None = column("Where it was published, where that is known")
    extents: tuple[float, ...] = column("Extents of the canonical model along x, y, z", unit="m", length=3, minimum=0)
    vertex_count: int = column("Vertices of the model", minimum=4)
    face_count: int = column("Faces of the model", minimum=4)
    volume_m3: float = column("Volume of the solid, of its convex hull when it is not closed", unit="m3", minimum=0)
    is_watertight: bool = column("The asset's mesh is closed")
    open_reason: str | None = column("Why it is not closed: edges of one face, or of more than two")
    has_texture: bool = column("It has a picture on it")
    duplicate_of: str | None = column("The first file that holds the same; null for that one")
    duplicate_by: str | None = column("What is the same: all bytes, or the geometry, whatever its colors", values=("bytes", "geometry"))
    weights: str | None = column("Hash of the model that its vectors are of; null where it has none", pattern=HASH)
    notes: tuple[str, ...] = column("What is odd or missing, a line each")
    asset_id: str = column("Asset that candidates are given", pattern=HASH)
    model_blob: str = column("The asset: canonical GLB, +Z up, metres, origin at the bottom center", blob=True)
    thumbnail_blob: str = column("Small picture of the asset, PNG", blob=True)
    entry_blob: str = column("Entry of the index, JSON: descriptors and vectors", blob=True)


@record("refused_models", key=("library", "file"), stage="indexing", grain="library")
class RefusedModel:
    """A file of a library that cannot be offered, and why."""

    library: str = column("Library", pattern=LIBRARY_PATTERN)
    file: str = column("File, relative to the library's folder")
    field: str = column("What of it is wrong: content, faces, size, file, ...")
    reason: str = column("Why it was refused, in a line")
