"""Indexing a library: one entry from one file and what is known of it, remembered by content, so that a killed indexing goes on.

An entry depends on the file's bytes and facts alone. Files can be indexed in any order, by any number of processes, on any machine.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset, TextureCharts
from schemas.errors import InputError, LakeError
from schemas.record import check
from schemas.text import one_line
from tasks.candidates.assets import MAX_EXTENT_M, MIN_EXTENT_M, MadeAsset, charted, make_asset
from tasks.captions.physics import known_name
from tasks.geometry.meshes import load_glb, sample_surface, surface_of
from tasks.geometry.pieces import PieceConfig, asset_pieces
from tasks.library.catalog import Catalog
from tasks.library.categories import category_of
from tasks.library.descriptors import describe
from tasks.library.duplicates import marked, signature_of
from tasks.library.embeddings import encoder_in
from tasks.library.entry import IndexEntry, dumped, loaded
from tasks.library.fields import field_of
from tasks.library.formats import content_of, model_files, read_model, skipped_note
from tasks.library.metadata import ModelFacts
from tasks.library.units import canonical_parts, convention_of
from tasks.selection.methods.encoders import weights_digest
from tasks.settings import Config, Count
from tasks.views.pictures import around

if TYPE_CHECKING:
    import trimesh

DESCRIBED, LAID = 1500, 6000
"""Surface points for the descriptor, as many as a scan of a small thing has, and for the field, whose grid is coarser than their gaps."""

PITCHES_RADIANS = (0.35,)
"""How far cameras look down: as people look at furniture."""


@dataclasses.dataclass(frozen=True)
class IndexConfig(Config):
    """What an entry holds. The index depends on it: another config makes other entries."""

    version: str = "4"  # goes up when the same file would make another entry
    views: Count = 8  # pictures that are embedded: quarters and what lies between, so that one comes near to any photograph
    pieces: bool = False  # convex pieces are cut now and remembered, up to 10 s a model; else when a scene first holds it
    weights: str = ""  # folder of CLIP or SigLIP; none ships, and without one entries have no vectors


Refusals = dict[str, str]
"""Why files have no entry, a line each, by file."""


@dataclasses.dataclass(frozen=True)
class ModelIndex:
    """A library. entries: In the order of their files' names. refused: Files without an entry, and why. notes: What is odd about files."""

    entries: tuple[IndexEntry, ...]
    refused: Mapping[str, str]
    notes: tuple[str, ...]


class Shelf(Protocol):
    """Where files go that rows name, by the hashes of their contents: `<sha256>.<extension>`."""

    def refresh(self, name: str) -> bool:
        """Whether a file is there; if so, it stays as if it was put now."""

    def put(self, data: bytes, extension: str) -> str:
        """Keep a file; its name."""


def index_file(path: Path, root: Path, facts: ModelFacts, config: IndexConfig, content: str) -> tuple[IndexEntry, MadeAsset]:
    """The entry of a file below `root`, and its asset with the GLB; `content` is its hash, as of `content_of`.

    Raises:
        InputError: it cannot be used; says why.
    """
    file = path.relative_to(root).as_posix()
    model = read_model(path, root)
    category, category_known = _category(path, facts)
    convention = convention_of(model, facts, category)
    parts = canonical_parts(model, convention)
    surface = surface_of(parts)
    extents = np.ptp(surface.bounds, axis=0)
    ordered = np.sort(extents)
    if ordered[1] < MIN_EXTENT_M or ordered[2] > MAX_EXTENT_M:
        size = " x ".join(f"{side:.3g}" for side in extents)
        raise InputError(file, "size", f"is {size} m, which is no object of a room", "state its unit in the index")
    # The same whatever the file is called: the generator is the content's.
    rng = np.random.default_rng(int(content[:15], 16))
    points, colors, _ = sample_surface(surface, DESCRIBED, rng)
    descriptor = describe(points, colors, extents, rng)
    points, _, _ = sample_surface(surface, LAID, rng)
    name = facts.name or path.stem
    vectors, text, weights = _vectors(parts, name, category, config)
    x, y, z = (float(side) for side in extents)
    made = _asset(parts, file, name, category, facts)
    entry = IndexEntry(
        file=file, content=content, format=model.format, unit_m=convention.unit_m, unit_known=convention.unit_known, up=convention.up,
        up_known=convention.up_known, front=convention.front, front_known=convention.front_known, category=category,
        category_known=category_known, name=name, license=facts.license.name, is_noncommercial=facts.license.is_noncommercial,
        author=facts.author, source_url=facts.source_url, extents=(x, y, z), vertex_count=len(surface.vertices),
        face_count=len(surface.faces), has_texture=bool(made.asset.has_texture),
        descriptor=descriptor, field=field_of(points), signature=signature_of(surface.vertices), image_vectors=vectors, text_vector=text,
        weights=weights, asset=made.asset, charts=made.charts,
        notes=tuple(note for note in (*model.notes, convention.note) if note),
    )  # fmt: skip
    return entry, made


def _asset(parts: list[trimesh.Trimesh], file: str, name: str, category: str, facts: ModelFacts) -> MadeAsset:
    """The asset of canonical parts.

    Raises:
        InputError: they are none, most often for want of faces.
        RecordError: a table refuses a value of the asset.
    """
    source, license_, author = facts.source_url or file, facts.license.name, facts.author or None
    try:
        made = make_asset(
            parts, provider=PROVIDER, name=name, category=category, source=source, license=license_, author=author,
            source_url=facts.source_url or None,
        )  # fmt: skip
    except ValueError as error:
        raise InputError(file, "meshes", str(error), "export it with its geometry") from error
    made = charted(made, parts)
    # A value that a table refuses leaves this file out, not the whole library.
    check([made.asset], Asset)
    check([made.charts] if made.charts is not None else [], TextureCharts)
    return made


PROVIDER = "library"
"""The candidate provider that offers what is indexed."""


def entry_key(content: str, facts: ModelFacts, file: str, config: IndexConfig, weights: str) -> str:
    """What an entry is remembered by: the file's content, name and facts, the code's version and settings, and the model's hash."""
    settings = dataclasses.asdict(config) | {"weights": weights, "pieces": None}  # which are no part of an entry
    text = json.dumps([content, file, dataclasses.asdict(facts), settings], sort_keys=True, default=str)
    return f"entry-{hashlib.sha256(text.encode('utf-8', 'surrogatepass')).hexdigest()}"


def index_remembered(
    path: Path, root: Path, facts: ModelFacts, config: IndexConfig, store: MutableMapping[str, bytes], shelf: Shelf | None = None,
    cut: MutableMapping[str, bytes] | None = None,
) -> IndexEntry | str:  # fmt: skip
    """The entry of a file out of the store, or made and put there; or why it has none, which is remembered likewise.

    shelf: Where the asset's files go, and the entry as JSON; None keeps none of them. cut: Where convex pieces of assets are remembered,
    as the stages that ask for them do; None cuts none.
    """
    file = path.relative_to(root).as_posix()
    try:
        file.encode()  # names are kept in rows
        content = content_of(path, root)
    except (LakeError, OSError, ValueError) as error:
        return _reason(error, file, root)
    key = entry_key(content, facts, file, config, weights_digest(config.weights) if config.weights else "")
    kept = store.get(key)
    if kept is not None:
        if kept.startswith(REFUSED):
            return kept[len(REFUSED) :].decode()
        try:
            entry = loaded(kept)
            _shelve(entry, lambda: entry_asset(entry, root, facts), shelf, cut)
            return entry
        except (LakeError, OSError, ValueError):  # a store that was cut off, or of other code
            pass
    try:
        entry, made = index_file(path, root, facts, config, content)
    except (LakeError, ValueError) as error:
        reason = _reason(error, file, root)
        store[key] = REFUSED + reason.encode()
        return reason
    _shelve(entry, lambda: made, shelf, cut)
    store[key] = dumped(entry)
    return entry


def _shelve(
    entry: IndexEntry, made: Callable[[], MadeAsset], shelf: Shelf | None, cut: MutableMapping[str, bytes] | None
) -> None:  # fmt: skip
    """Put what belongs to an entry where it is to lie, as far as it is not there."""
    if cut is not None:
        asset = entry.asset
        asset_pieces(asset.asset_id, lambda: load_glb(made().files[asset.mesh_blob], entry.file), None, PieceConfig(), cut)
    if shelf is None:
        return
    missing = [name for name in asset_blobs(entry.asset) if not shelf.refresh(name)]
    files = made().files if missing else {}
    for name in missing:
        shelf.put(files[name], name.rpartition(".")[2])
    shelf.put(dumped(entry), "json")


def asset_blobs(asset: Asset) -> list[str]:
    """Names of the blobs of an asset."""
    return [name for name in (asset.mesh_blob, asset.pieces_blob, asset.thumbnail_blob) if name is not None]


REFUSED = b"refused "
"""Before the reason in a store."""

ListedFile = tuple[Path, ModelFacts]
"""A file, and what is known of it."""

Spread = Callable[[Callable[[ListedFile], "IndexEntry | str"], Sequence[ListedFile]], Iterable["IndexEntry | str"]]
"""Calls a function for each of some files, in their order: one after the other, or in many processes."""


def index_folder(
    folder: Path, catalog: Catalog, config: IndexConfig, store: MutableMapping[str, bytes], spread: Spread = map,
    shelf: Shelf | None = None, cut: MutableMapping[str, bytes] | None = None,
) -> ModelIndex:  # fmt: skip
    """The index of all models below a folder. What the store has is not computed again. shelf, cut: See `index_remembered`.

    Raises:
        InputError: there is no such folder, or the config names weights that cannot be used.
    """
    if config.weights:
        encoder_in(config.weights)
    files, unused = model_files(folder)
    refused = dict(_named(line).split(": ", 1) for line in unused)
    listed = [(path, catalog.of(path.relative_to(folder).as_posix())) for path in files]
    entries = []
    for path, made in zip(files, spread(_Work(folder, config, store, shelf, cut), listed), strict=True):
        if isinstance(made, str):
            refused[_named(path.relative_to(folder).as_posix())] = made
        else:
            entries.append(made)
    by_file = {entry.file: entry for entry in entries}
    done = marked(entries, lambda entry: _vertices(folder, by_file[entry.file], catalog))
    notes = [f"{entry.file}: {note}" for entry in done for note in entry.notes]
    return ModelIndex(tuple(done), dict(sorted(refused.items())), (*notes, *skipped_note(folder)))


@dataclasses.dataclass(frozen=True)
class _Work:
    """What is done with a file; can be sent to other processes, as far as the store can."""

    folder: Path
    config: IndexConfig
    store: MutableMapping[str, bytes]
    shelf: Shelf | None
    cut: MutableMapping[str, bytes] | None

    def __call__(self, listed: ListedFile) -> IndexEntry | str:
        path, facts = listed
        return index_remembered(path, self.folder, facts, self.config, self.store, self.shelf, self.cut)


def entry_parts(entry: IndexEntry, folder: Path, facts: ModelFacts) -> list[trimesh.Trimesh]:
    """The canonical parts of an entry's file [m], +Z up.

    Raises:
        InputError: the file cannot be read any more, or is another since it was indexed.
    """
    path = folder / entry.file
    if content_of(path, folder) != entry.content:
        raise InputError(entry.file, "content", "is another than when it was indexed", "index the library again")
    model = read_model(path, folder)
    return canonical_parts(model, convention_of(model, facts, entry.category))


def entry_asset(entry: IndexEntry, folder: Path, facts: ModelFacts) -> MadeAsset:
    """The asset of an entry with its GLB, made of the file again.

    Raises:
        InputError: as `entry_parts`; or other code makes another asset of it.
    """
    made = _asset(entry_parts(entry, folder, facts), entry.file, entry.name, entry.category, facts)
    if made.asset != entry.asset:
        raise InputError(entry.file, "asset", "is another than when it was indexed", "index the library again")
    return made


def _vertices(folder: Path, entry: IndexEntry, catalog: Catalog) -> NDArray[np.float64] | None:
    try:
        return surface_of(entry_parts(entry, folder, catalog.of(entry.file))).vertices
    except (LakeError, OSError, ValueError):
        return None


def _category(path: Path, facts: ModelFacts) -> tuple[str, str]:
    """Category in the project's words where they have one, and how it is known."""
    if facts.category:
        return known_name(facts.category) or facts.category, facts.category_source or "metadata"
    return category_of(path.stem), "file name"


def _vectors(parts: list[trimesh.Trimesh], name: str, category: str, config: IndexConfig) -> tuple[Any, Any, str]:
    """Vectors of pictures from around and of a text, and the hash of the model; None where the config names none."""
    if not config.weights:
        return None, None, ""
    encoder = encoder_in(config.weights)
    pictures = encoder.images(around(parts, config.views, PITCHES_RADIANS, encoder.side))
    return pictures, encoder.texts([f"A photo of a {category}: {name}."])[0], weights_digest(config.weights)


def _reason(error: Exception, file: str, root: Path) -> str:
    """Why a file is refused, in a line that is the same wherever its library lies: without the library's path, and without the file's name
    at its beginning, unless it is another's."""
    text = one_line(error)
    if isinstance(error, InputError) and error.file.endswith(one_line(file).rpartition("/")[2]):
        text = text.removeprefix(f"{error.file}: ")
    return _named(text.replace(f"{root.absolute()}/", ""))[:300]


def _named(text: str) -> str:
    """A text that can be kept: bytes of a file's name that are none become question marks."""
    return text.encode("utf-8", "replace").decode()


def refused_first(index: ModelIndex) -> Iterator[str]:
    """Lines for people: what was refused, then what is odd."""
    yield from (f"{file}: {why}" for file, why in index.refused.items())
    yield from index.notes
