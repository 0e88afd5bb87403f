"""`croissant.json`: a release as Croissant 1.1 says it, the JSON-LD vocabulary by which search engines and loaders know data sets."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from schemas.tables import TABLES
from schemas.text import escaped
from schemas.wording import noun

if TYPE_CHECKING:
    from schemas.record import Column, Table
    from schemas.runs import Release
    from warehouse.release.attribution import Attribution
    from warehouse.release.card import ReleaseFile

NAME = "croissant.json"

CONFORMS_TO = "http://mlcommons.org/croissant/1.1"

_KINDS = {".parquet": "application/x-parquet", ".md": "text/markdown", ".duckdb": "application/vnd.duckdb", ".json": "application/json"}
"""Media types by ending; Parquet's as readers of Croissant know it."""

_TYPES: dict[pa.DataType, str] = {pa.string(): "sc:Text", pa.int64(): "cr:Int64", pa.float64(): "cr:Float64", pa.bool_(): "sc:Boolean",
                                  pa.timestamp("us", tz="UTC"): "sc:DateTime"}  # fmt: skip


def _description(release: Release) -> str:
    """What a release holds, in a sentence, and what who made it says of it."""
    scans = f"{release.rooms:,} real {noun(release.rooms, 'room')}"
    scenes = f"{release.scenes:,} {noun(release.scenes, 'replica scene')} for simulators"
    objects = f"{release.objects:,} {noun(release.objects, 'object')}"
    categories = f"{release.categories:,} {noun(release.categories, 'category', 'categories')}"
    episodes = f"{release.episodes:,} {noun(release.episodes, 'episode')}"
    placed = f"{release.placed_objects:,} of them replaced by assets"
    text = f"Scans of {scans} as {scenes}: {objects} of {categories}, {placed}, and {episodes}, as rows of a scene lake."
    return f"{text} {release.notes}" if release.notes else text


def croissant(release: Release, attribution: Attribution, files: Sequence[ReleaseFile], citation: str) -> str:
    """The JSON of a release: its files with their checksums, and a record set of each table with what its columns mean.

    Args:
        release: What is described.
        attribution: For its licenses.
        files: All files that are written already.
        citation: How the data card cites it.
    """
    licenses = sorted({credit.license for credit in (*attribution.scans, *attribution.assets)})
    fields: dict[str, Any] = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "name": f"metascenes-lake-{release.name}",
        "description": _description(release),
        "conformsTo": CONFORMS_TO,
        "license": licenses or ["unknown"],
        "citeAs": citation,
        "datePublished": f"{release.created_at:%Y-%m-%d}",
        # what was erased from a release makes another one of it
        "version": f"{release.snapshot_id}.{len(release.erased_at)}.0",
        "isLiveDataset": False,
        "distribution": [_file(file) for file in files],
        "recordSet": [_record_set(TABLES[name]) for file in files if (name := file.path.removesuffix(".parquet")) in TABLES],
    }
    if release.erased_at:
        fields["dateModified"] = max(release.erased_at)[:10]
    return escaped(json.dumps(fields, indent=1, ensure_ascii=False)) + "\n"


def _file(file: ReleaseFile) -> dict[str, Any]:
    return {
        "@type": "cr:FileObject",
        "@id": file.path,
        "name": file.path,
        "contentUrl": file.path,
        "contentSize": f"{file.bytes} B",
        "encodingFormat": next((kind for ending, kind in _KINDS.items() if file.path.endswith(ending)), "application/octet-stream"),
        "sha256": file.sha256,
    }


def _record_set(table: Table) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": table.name,
        "name": table.name,
        "description": table.description,
        "key": [{"@id": f"{table.name}/{name}"} for name in table.key],
        "field": [_field(table, column) for column in table.columns],
    }


def _field(table: Table, column: Column) -> dict[str, Any]:
    element, shape = column.type, list[int]()
    while pa.types.is_list(element):
        # how many there are is stated of the outermost alone
        shape.append(column.length if column.length is not None and not shape else -1)
        element = element.value_type
    field: dict[str, Any] = {
        "@type": "cr:Field",
        "@id": f"{table.name}/{column.name}",
        "name": column.name,
        "description": column.comment,
        "dataType": _TYPES[element],
        "source": {"fileObject": {"@id": f"{table.name}.parquet"}, "extract": {"column": column.name}},
    }
    return field | ({"isArray": True, "arrayShape": ",".join(map(str, shape))} if shape else {})


_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "arrayShape": "cr:arrayShape",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isArray": "cr:isArray",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
"""The vocabulary's own context, as its specification gives it."""
