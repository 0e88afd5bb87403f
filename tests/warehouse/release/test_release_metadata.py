"""What a release says of itself to others: the head of its card for the Hugging Face Hub, and Croissant, each read by its own library."""

from __future__ import annotations

import hashlib
import json
from datetime import datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from schemas.runs import Release
from schemas.tables import TABLES
from tests.samples import sample
from tests.warehouse.release.test_release_folder import filled
from warehouse.release import make_release
from warehouse.release.attribution import Attribution, Credit
from warehouse.release.card import ReleaseFile
from warehouse.release.croissant import _KINDS, croissant
from warehouse.release.hub import SPLIT, card_head, without_head


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a release with rows in some tables and none in others."""
    lake = filled(tmp_path_factory.mktemp("described") / "lake")
    make_release(lake, "v1", notes='for the "paper": <all> of it')
    return Path(lake.address, "releases", "v1")


def rows_of(folder: Path) -> dict[str, int]:
    return {name: pq.ParquetFile(folder / f"{name}.parquet").metadata.num_rows for name in TABLES}


def test_the_hub_reads_the_card(folder: Path) -> None:
    library = pytest.importorskip("huggingface_hub", reason="the Hub's library is not installed")
    card = library.DatasetCard.load(folder / "README.md", ignore_metadata_errors=False)
    assert card.data.pretty_name == "MetaScenes lake, release v1"
    assert (card.data.license, card.data.license_name, card.data.license_link) == ("other", "several-see-attribution", "ATTRIBUTION.md")
    assert (folder / card.data.license_link).is_file()
    assert card.text.lstrip().startswith("# Data card: release v1\n")
    files = {config["config_name"]: config["data_files"] for config in card.data.configs}
    held = {name for name, rows in rows_of(folder).items() if rows}
    assert files == {name: [{"split": SPLIT, "path": f"{name}.parquet"}] for name in held}
    assert [config["config_name"] for config in card.data.configs if config.get("default")] == ["scenes"]
    assert library.DatasetCard(card.content).data.to_dict() == card.data.to_dict(), "written again it says the same"


@pytest.mark.whole
def test_datasets_loads_every_table_that_has_rows(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    library = pytest.importorskip("datasets", reason="the library `datasets` is not installed")
    monkeypatch.setattr(library.config, "HF_HUB_OFFLINE", True)
    held = {name: rows for name, rows in rows_of(folder).items() if rows}
    assert set(library.get_dataset_config_names(str(folder))) == set(held)
    for name in held:
        loaded = library.load_dataset(str(folder), name, split=SPLIT, cache_dir=str(tmp_path))
        known = pq.read_table(folder / f"{name}.parquet")
        assert loaded.column_names == known.column_names
        assert loaded.with_format("arrow")[:].to_pylist() == known.to_pylist()
    assert library.load_dataset(str(folder), split=SPLIT, cache_dir=str(tmp_path)).num_rows == held["scenes"], "by default"


@pytest.mark.whole
def test_croissant_is_sound_and_gives_the_rows(folder: Path) -> None:
    library = pytest.importorskip("mlcroissant", reason="Croissant's library is not installed")
    dataset = library.Dataset(jsonld=str(folder / "croissant.json"))
    issues = dataset.metadata.ctx.issues
    assert not issues.errors
    assert {record.id for record in dataset.metadata.record_sets} == set(TABLES)
    for name in ("scenes", "instances", "placements", "stage_runs"):
        known = pq.read_table(folder / f"{name}.parquet").to_pylist()
        assert known
        read = [{field.removeprefix(f"{name}/"): plain(value) for field, value in row.items()} for row in dataset.records(name)]
        assert read == [{field: plain(value) for field, value in row.items()} for row in known]


def plain(value: Any) -> Any:
    """A value as Python's own: the library gives bytes for texts, and what NumPy and pandas make of numbers and times."""
    if isinstance(value, bytes):
        return value.decode()
    if isinstance(value, list | tuple) or hasattr(value, "tolist"):
        value = value.tolist() if hasattr(value, "tolist") else value
        return [plain(item) for item in value] if isinstance(value, list | tuple) else plain(value)
    if isinstance(value, datetime):
        return value.timestamp()
    return None if value is None or value != value else value


def described(folder: Path) -> dict[str, Any]:
    """The metadata, without a library."""
    document: dict[str, Any] = json.loads((folder / "croissant.json").read_text())
    return document


def test_croissant_names_every_file_with_its_checksum_and_every_column_with_its_meaning(folder: Path) -> None:
    document = described(folder)
    listed = {file["@id"]: file for file in document["distribution"]}
    about_others = {"SHA256SUMS", "release.json", "croissant.json"}
    assert listed.keys() == {path.name for path in folder.iterdir()} - about_others
    for name, file in listed.items():
        data = (folder / name).read_bytes()
        assert (file["contentUrl"], file["sha256"]) == (name, hashlib.sha256(data).hexdigest())
        assert file["contentSize"] == f"{len(data)} B"
        assert file["encodingFormat"] == _KINDS[Path(name).suffix]
    records = {record["@id"]: record for record in document["recordSet"]}
    assert records.keys() == TABLES.keys()
    kinds = {"sc:Text": pa.string(), "cr:Int64": pa.int64(), "cr:Float64": pa.float64(), "sc:Boolean": pa.bool_(),
             "sc:DateTime": pa.timestamp("us", tz="UTC")}  # fmt: skip
    for name, record in records.items():
        schema = pq.read_schema(folder / f"{name}.parquet")
        assert [field["name"] for field in record["field"]] == schema.names
        for field in record["field"]:
            made = kinds[field["dataType"]]
            for _ in field["arrayShape"].split(",") if field.get("isArray") else ():
                made = pa.list_(made)
            assert made == schema.field(field["name"]).type
            known = schema.field(field["name"]).metadata
            assert field["description"].startswith(known[b"description"].decode())
            assert known[b"unit"].decode() in field["description"]
            assert field["source"] == {"fileObject": {"@id": f"{name}.parquet"}, "extract": {"column": field["name"]}}
        assert [key["@id"] for key in record["key"]] == [f"{name}/{column}" for column in TABLES[name].key]
    assert {field["arrayShape"] for field in records["instances"]["field"] if field["name"] == "box_pose"} == {"16"}


def test_croissant_cites_and_licenses_as_the_card_and_the_attribution_do(folder: Path) -> None:
    document, card = described(folder), (folder / "README.md").read_text()
    cited = " ".join(line.removeprefix("> ") for line in card.splitlines() if line.startswith("> "))
    assert document["citeAs"] == cited
    page = (folder / "ATTRIBUTION.md").read_text()
    lines = [line.split(" | ")[0].removeprefix("| ") for line in page.splitlines() if line.startswith("| ")]
    assert document["license"] == sorted({name for name in lines if name != "license"})
    assert 'for the "paper": <all> of it' in document["description"]


@pytest.mark.whole
def test_what_was_erased_is_in_neither(tmp_path: Path) -> None:
    """The erased scene is named nowhere, all counts and checksums are of what is left, and the version tells."""
    from tests.warehouse.lake_load import scene_id
    from warehouse.upkeep.erasure import erase

    lake = filled(tmp_path / "lake")
    make_release(lake, "v1")
    folder = Path(lake.address, "releases", "v1")
    before = described(folder)
    erase(lake, scene_id(1))
    document = described(folder)
    for name in ("croissant.json", "README.md"):
        assert scene_id(1) not in (folder / name).read_text()
    assert before["version"].endswith(".0.0")
    assert document["version"] == before["version"].removesuffix("0.0") + "1.0"
    assert document["dateModified"] >= document["datePublished"]
    files = {file["@id"]: file["sha256"] for file in document["distribution"]}
    assert files == {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in files}
    assert files["scenes.parquet"] != next(file["sha256"] for file in before["distribution"] if file["@id"] == "scenes.parquet")


def credits(*licenses: str) -> Attribution:
    return Attribution(tuple(Credit(license_, "a", "b", 1, 1) for license_ in licenses), ())


def head(attribution: Attribution, files: list[ReleaseFile]) -> dict[str, Any]:
    text = card_head(sample(Release, name="v1"), attribution, files)
    assert text.startswith("---\n")
    assert text.endswith("\n---\n")
    fields: dict[str, Any] = yaml.safe_load(text.removeprefix("---\n").removesuffix("---\n"))
    return fields


@pytest.mark.parametrize(
    ("licenses", "said"),
    [
        (["CC0-1.0"], {"license": "cc0-1.0"}),
        (["CC-BY-4.0", "CC0-1.0", "CC-BY-4.0"], {"license": ["cc-by-4.0", "cc0-1.0"]}),
        (["CC-BY-4.0", "unknown"], {"license": "other", "license_name": "several-see-attribution", "license_link": "ATTRIBUTION.md"}),
        (["Terms of a museum"], {"license": "other", "license_name": "several-see-attribution", "license_link": "ATTRIBUTION.md"}),
        (["unknown"], {"license": "unknown"}),
        ([], {"license": "unknown"}),
    ],
)
def test_licenses_in_the_words_of_the_hub(licenses: list[str], said: dict[str, Any]) -> None:
    fields = head(credits(*licenses), [])
    assert {name: fields[name] for name in ("license", "license_name", "license_link") if name in fields} == said
    assert "configs" not in fields, "there is nothing to load"


@given(counts=st.lists(st.integers(0, 10**10), max_size=4))
def test_the_size_is_that_of_the_rows_of_the_stages(counts: list[int]) -> None:
    names = ("scenes", "instances", "placements", "stage_runs")
    files = [ReleaseFile(f"{name}.parquet", 1, "0", rows) for name, rows in zip(names, counts, strict=False)]
    fields = head(credits("MIT"), files)
    total = sum(counts[:3])  # what the lake says of itself does not count
    (size,) = fields["size_categories"]
    bounds = [("n", 0)] + [(unit, 10**power) for power, unit in ((3, "1K"), (4, "10K"), (5, "100K"), (6, "1M"), (7, "10M"), (8, "100M"),
                                                               (9, "1B"), (10, "10B"), (12, "1T"))]  # fmt: skip
    limits = dict(bounds)
    if size == "n<1K":
        assert total < 1000
    elif size.startswith("n>"):
        assert total >= 10**10
    else:
        low, _, high = size.split("<")
        assert limits[low] <= total < limits[high]
    assert [config["config_name"] for config in fields.get("configs", [])] == [
        name for name in ("scenes", *sorted(names[1:])) if dict(zip(names, counts, strict=False)).get(name)
    ]


@given(text=st.text())
def test_people_read_the_card_without_its_head(text: str) -> None:
    body = f"# Data card\n{text}"
    assert without_head(card_head(sample(Release, name="v1"), credits("MIT"), []) + body) == body
    assert without_head(body) == body


def test_the_same_release_gives_the_same_metadata() -> None:
    release = sample(Release, name="v1")
    files = [ReleaseFile("scenes.parquet", 1, "0", 1)]
    made = [
        (card_head(release, credits("MIT", "CC0-1.0"), files), croissant(release, credits("MIT", "CC0-1.0"), files, "c")) for _ in range(2)
    ]
    assert made[0] == made[1]
