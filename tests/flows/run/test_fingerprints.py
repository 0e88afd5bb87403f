"""Fingerprints: content decides, comments do not count, damage to a cache costs time and nothing else."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flows.run import fingerprints
from flows.run.fingerprints import FileCache, FileHashes, Fingerprint, canonical_json, code_fingerprint, digest
from tests.conftest import REPOSITORY

AGO = 3600
"""Files of tests are made to look this old [s], so that their hashes may be remembered."""


def write(path: Path, content: bytes) -> Path:
    """A file whose modification lies in the past. The change time cannot be set: it is now."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    os.utime(path, (time.time() - AGO,) * 2)
    return path


@pytest.fixture
def settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files count as settled at once, for tests that are about what happens to remembered hashes."""
    monkeypatch.setattr(fingerprints, "RACY_SECONDS", -1.0)


def scan(folder: Path) -> list[Path]:
    return [write(folder / "a.ply", b"mesh"), write(folder / "frames" / "0.png", b"image"), write(folder / "b.txt", b"text")]


def tree(root: Path, files: list[Path], store: Path) -> str:
    hashes = FileHashes(store)
    value = hashes.tree(root, files)
    hashes.save()
    return value


@pytest.mark.usefixtures("settled")
def test_content_decides_and_neither_time_nor_place(tmp_path: Path) -> None:
    store, root = tmp_path / "store.json", tmp_path / "one"
    files = scan(root)
    first = tree(root, files, store)
    assert store.is_file()
    assert tree(root, files, store) == first
    assert tree(root, files[::-1], store) == first, "the order of the list"
    os.utime(files[0])
    assert tree(root, files, store) == first, "touched"
    shutil.copytree(root, tmp_path / "two")
    copied = [tmp_path / "two" / path.relative_to(root) for path in files]
    assert tree(tmp_path / "two", copied, store) == first, "copied"
    copied[1].write_bytes(b"imagE")
    assert tree(tmp_path / "two", copied, store) != first, "one byte"
    assert tree(root, files, store) == first


@pytest.mark.usefixtures("settled")
def test_a_byte_changed_behind_an_unchanged_time_stamp_is_seen(tmp_path: Path) -> None:
    file = write(tmp_path / "a", b"before")
    store = tmp_path / "store.json"
    first = tree(tmp_path, [file], store)
    stat = file.stat()
    file.write_bytes(b"bEfore")
    os.utime(file, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert file.stat().st_mtime_ns == stat.st_mtime_ns
    assert tree(tmp_path, [file], store) != first


def test_names_and_the_set_of_files_count(tmp_path: Path) -> None:
    files = scan(tmp_path / "scan")
    store, root = tmp_path / "store.json", tmp_path / "scan"
    first = tree(root, files, store)
    assert tree(root, files[:-1], store) != first
    renamed = files[2].rename(root / "c.txt")
    assert tree(root, [*files[:2], renamed], store) != first


@pytest.mark.usefixtures("settled")
def test_a_remembered_hash_is_used(tmp_path: Path) -> None:
    """Without this, the tests of damage below could pass on a store that nobody reads."""
    file, store = write(tmp_path / "a", b"content"), tmp_path / "store.json"
    value = tree(tmp_path, [file], store)
    real = FileHashes(store).hash(file)
    store.write_text(store.read_text().replace(real, "f" * 64))
    assert FileHashes(store).hash(file) == "f" * 64
    file.write_bytes(b"content")
    assert tree(tmp_path, [file], store) == value, "written again: read again"


@pytest.mark.usefixtures("settled")
@pytest.mark.parametrize(
    "damage", [b"[]", b"3", b"null", b"", b"{", b'"text"', b"\xff\xfe\x00", b"KEY:1", b"KEY:[]", b"KEY:null", b"KEY:[1,2]"]
)
def test_a_damaged_store_is_ignored_and_mended(tmp_path: Path, damage: bytes) -> None:
    file, store = write(tmp_path / "a", b"content"), tmp_path / "cache" / "store.json"
    expected = tree(tmp_path, [file], tmp_path / "whole.json")
    store.parent.mkdir()
    store.write_bytes(b'{"%s": %s}' % (str(file).encode(), damage[4:]) if damage.startswith(b"KEY:") else damage)
    assert tree(tmp_path, [file], store) == expected
    assert store.read_bytes() == (tmp_path / "whole.json").read_bytes()


def test_a_file_changed_just_now_is_not_remembered(tmp_path: Path) -> None:
    file, store = tmp_path / "a", tmp_path / "store.json"
    file.write_bytes(b"content")
    tree(tmp_path, [file], store)
    assert not store.exists() or str(file) not in store.read_text()


def test_a_cache_that_cannot_be_written_costs_nothing_but_time(tmp_path: Path) -> None:
    files = scan(tmp_path / "scan")
    (tmp_path / "plain").write_text("a file where the cache's folder should be")
    blocked = tmp_path / "plain" / "store.json"
    expected = tree(tmp_path / "scan", files, tmp_path / "store.json")
    assert tree(tmp_path / "scan", files, blocked) == expected


@given(st.lists(st.text(max_size=4), max_size=4), st.lists(st.text(max_size=4), max_size=4))
def test_different_lists_of_texts_have_different_digests(one: list[str], other: list[str]) -> None:
    assert (digest(*one) == digest(*other)) == (one == other)


COPIED_STAGE = "tasks.captions"
"""The stage whose code is changed here: it has modules, data files and imports of the rooms' shared modules."""


@pytest.fixture
def code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A copy of the rooms that count as code; fingerprints are taken of it, anew each time."""
    for room in fingerprints.ROOMS:
        shutil.copytree(REPOSITORY / room, tmp_path / room, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(fingerprints, "ROOT", tmp_path)
    forget()
    yield tmp_path
    forget()


def forget() -> None:
    """Drop what the module remembers of files between calls."""
    for value in vars(fingerprints).values():
        if hasattr(value, "cache_clear"):
            value.cache_clear()


def fingerprint(module: str = COPIED_STAGE) -> str:
    forget()
    return code_fingerprint(module)


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_the_place_of_the_code_does_not_count(code: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here = fingerprint()
    assert fingerprint() == here
    assert fingerprint("tasks.navigation") != here
    monkeypatch.setattr(fingerprints, "ROOT", REPOSITORY)
    assert fingerprint() == here


@pytest.mark.whole
def test_what_is_remembered_of_code_counts_for_these_files_only(code: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    store, own = fingerprints._code_stores()
    assert (store.is_relative_to(code), own.parent) == (True, tmp_path / "cache")
    computed: list[str] = []
    compute = fingerprints._fingerprint_of

    def counted(module: str) -> str:
        computed.append(module)
        return compute(module)

    monkeypatch.setattr(fingerprints, "_fingerprint_of", counted)
    found = {module: fingerprint(module) for module in (COPIED_STAGE, "tasks.navigation", COPIED_STAGE)}
    assert {module: fingerprint(module) for module in found} == found
    assert computed == list(found), "each once, in whatever process"
    whole = store.read_text()
    for damage in ("", "{", "[]", "null", '{"contents": 1}', whole[: len(whole) // 2], whole.replace(found[COPIED_STAGE], "0")):
        store.write_text(damage)
        assert fingerprint() == found[COPIED_STAGE], damage
    file = code / "tasks" / "captions" / "colors.py"
    text = file.read_text()
    file.write_text(text + "\nADDED = 1\n")
    assert fingerprint() != found[COPIED_STAGE]
    file.write_text(text)
    assert fingerprint() == found[COPIED_STAGE]
    shutil.rmtree(store.parent)
    store.parent.write_text("no folder")
    assert not own.exists()
    assert fingerprint() == found[COPIED_STAGE]
    assert set(json.loads(own.read_bytes())["modules"]) == {COPIED_STAGE}
    computed.clear()
    assert fingerprint() == found[COPIED_STAGE]
    own.write_text("broken")
    assert fingerprint() == found[COPIED_STAGE]
    assert computed == [COPIED_STAGE]


def test_comments_docstrings_and_blank_lines_do_not_count(code: Path) -> None:
    before = fingerprint()
    module = code / "tasks" / "captions" / "colors.py"
    text = module.read_text()
    assert text.startswith('"""')
    module.write_text('"""Another docstring.\n\nOf three lines.\n"""\n\n\n# a comment\n' + text.split('"""', 2)[2] + "\n# the end\n")
    assert module.read_text() != text
    assert fingerprint() == before


@pytest.mark.whole
def test_code_counts_wherever_the_stage_imports_it_and_nowhere_else(code: Path) -> None:
    before, navigation = fingerprint(), fingerprint("tasks.navigation")
    for path in (
        "tasks/captions/__init__.py",
        "tasks/captions/colors.py",
        "tasks/captions/sentences.py",
        "schemas/captions.py",
        "tasks/geometry/meshes.py",
    ):
        file = code / path
        text = file.read_text()
        file.write_text(text + "\nADDED = 1\n")
        assert fingerprint() != before, path
        file.write_text(text)
    assert fingerprint() == before
    (code / "tasks" / "captions" / "colors.py").write_text((code / "tasks" / "captions" / "colors.py").read_text() + "\nADDED = 1\n")
    assert fingerprint("tasks.navigation") == navigation, "navigation does not import it"


def changed(code: Path, path: str, modules: tuple[str, ...] = ("tasks.capture", "tasks.exports", "tasks.navigation")) -> set[str]:
    """Modules whose fingerprints another file at a path changes."""
    file, before = code / path, {module: fingerprint(module) for module in modules}
    text = file.read_text()
    file.write_text(text + "\nADDED = 1\n")
    found = {module for module in modules if fingerprint(module) != before[module]}
    file.write_text(text)
    return found


@pytest.mark.slow
def test_members_of_a_family_count_for_the_stage_that_has_them(code: Path) -> None:
    assert changed(code, "tasks/capture/scannet/layout.py") == {"tasks.capture", "tasks.exports"}, "exports read labels of the capture"
    assert changed(code, "tasks/exports/usd/layers.py") == {"tasks.exports"}
    assert changed(code, "tasks/exports/mjcf/rules.py") == {"tasks.exports"}
    assert changed(code, "tasks/navigation/recast.py") == {"tasks.navigation", "tasks.exports"}, "exports replay episodes"
    assert changed(code, "tasks/candidates/scan_crop.py", ("tasks.candidates", "tasks.selection")) == {"tasks.candidates"}
    assert changed(code, "tasks/evaluation/policies/random.py", ("tasks.evaluation", "tasks.navigation")) == {"tasks.evaluation"}


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize(
    "path",
    ["tasks/capture/scannet/wholeness.py", "tasks/capture/wholeness.py", "tasks/exports/usd/places.py", "tasks/exports/usd/omniverse.py"],
)
def test_what_only_a_watch_or_an_explanation_asks_of_a_member_makes_no_row_stale(code: Path, path: str) -> None:
    assert changed(code, path) == set()


@pytest.mark.slow
@pytest.mark.whole
def test_a_further_member_counts(code: Path) -> None:
    before = {module: fingerprint(module) for module in ("tasks.exports", "tasks.capture")}
    (code / "tasks" / "exports" / "obj.py").write_text("OBJ = 1\n")
    assert {module: fingerprint(module) for module in before} == before, "nobody names it"
    edit(code / "schemas" / "families" / "export_formats.py", "EXPORT_FORMATS = (", 'EXPORT_FORMATS = ("obj", ')
    named = fingerprint("tasks.exports")
    assert named != before["tasks.exports"]
    edit(code / "tasks" / "exports" / "obj.py", "1", "2")
    assert fingerprint("tasks.exports") not in (named, before["tasks.exports"])
    assert fingerprint("tasks.capture") == before["tasks.capture"]


def test_names_that_nobody_spells_out_are_refused(code: Path) -> None:
    """Members that are not seen would change, and rows would be taken for theirs."""
    edit(
        code / "tasks" / "exports" / "formats.py",
        'members("tasks.exports", EXPORT_FORMATS,',
        'members("tasks.exports", tuple(EXPORT_FORMATS),',
    )
    with pytest.raises(ValueError, match=r"members\('tasks\.exports', tuple\(EXPORT_FORMATS\), ExportFormat\): names must be imported"):
        fingerprint("tasks.exports")


def test_data_files_count(code: Path) -> None:
    before = fingerprint()
    table = code / "tasks" / "captions" / "materials.csv"
    raw = table.read_bytes()
    table.write_bytes(raw + b"\n")
    assert fingerprint() != before
    table.write_bytes(raw)
    assert fingerprint() == before
    table.rename(table.with_name("others.csv"))
    assert fingerprint() != before


def test_a_default_of_a_config_and_the_code_of_a_literal_count(code: Path) -> None:
    before = fingerprint()
    edit(code / "tasks" / "captions" / "classical.py", "min_points: Whole = 20", "min_points: Whole = 21")
    assert fingerprint() != before


@dataclasses.dataclass(frozen=True)
class Near:
    reach_m: float = 1.0


@dataclasses.dataclass(frozen=True)
class Far:
    reach_m: float = 1.0


@dataclasses.dataclass(frozen=True)
class Holder:
    member: Near | Far = Near()
    several: tuple[Near | Far, ...] = (Near(), Far())
    words: tuple[str, ...] = ("a",)


def test_members_of_a_union_differ_though_their_fields_are_the_same() -> None:
    assert canonical_json(Near()) != canonical_json(Far())
    texts = [
        canonical_json(holder)
        for holder in (Holder(), Holder(Far()), Holder(several=(Far(), Near())), Holder(several=(Near(),)), Holder(words=("b",)))
    ]
    assert len(set(texts)) == len(texts)
    assert canonical_json(Holder()) == canonical_json(Holder(Near(1.0)))


@given(
    st.dictionaries(st.text(max_size=3), st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=3), max_size=4)
)
def test_the_order_of_keys_does_not_count(values: dict[str, object]) -> None:
    assert canonical_json(values) == canonical_json(dict(reversed(values.items())))


def test_a_number_that_json_does_not_have_is_refused() -> None:
    with pytest.raises(ValueError):
        canonical_json(Near(float("nan")))


BASE = Fingerprint(("scan=11", "capture=22"), '{"type":"C"}', "33", 0)


@pytest.mark.parametrize(
    ("other", "names"),
    [
        (BASE, []),
        (dataclasses.replace(BASE, inputs=("scan=12", "capture=22")), ["scan"]),
        (dataclasses.replace(BASE, config="{}"), ["config"]),
        (dataclasses.replace(BASE, code="34"), ["code"]),
        (dataclasses.replace(BASE, seed=1), ["seed"]),
        (dataclasses.replace(BASE, inputs=("scan=11",)), ["capture"]),
        (dataclasses.replace(BASE, inputs=("scan=11", "capture=22", "library=5")), ["library"]),
        (dataclasses.replace(BASE, inputs=("scan=9", "capture=22"), seed=4), ["scan", "seed"]),
    ],
)
def test_a_difference_is_named_and_only_a_difference_changes_the_value(other: Fingerprint, names: list[str]) -> None:
    assert sorted(other.changes(BASE.parts)) == names
    assert sorted(BASE.changes(other.parts)) == names
    assert (other.value == BASE.value) == (not names)
    assert len(other.value) == 64


def test_values_come_back_from_a_cache_folder(tmp_path: Path) -> None:
    cache = FileCache(tmp_path / "deep" / "cache")
    assert list(cache) == []
    with pytest.raises(KeyError):
        cache["a"]
    cache["b"], cache["a"] = b"two", b"\x00one"
    cache["b"] = b"2"
    again = FileCache(tmp_path / "deep" / "cache")
    assert dict(again) == {"a": b"\x00one", "b": b"2"}
    assert (len(again), list(again)) == (2, ["a", "b"])
    del again["a"]
    assert "a" not in cache
    assert sorted(path.name for path in (tmp_path / "deep" / "cache").iterdir()) == ["b"], "nothing half written lies about"


def test_a_cache_folder_that_cannot_be_written_still_answers_within_the_run(tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("a file where the folder should be")
    cache = FileCache(tmp_path / "plain" / "cache")
    cache["a"] = b"one"
    assert cache["a"] == b"one"
    assert "b" not in cache
    assert "a" not in FileCache(tmp_path / "plain" / "cache"), "nothing was kept"


def test_an_unwritable_cache_is_a_mapping_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("a file where the folder should be")
    cache = FileCache(tmp_path / "plain" / "cache")
    cache["a"] = b"one"
    assert (list(cache), len(cache)) == (["a"], 1)
    del cache["a"]
    assert "a" not in cache


@pytest.mark.parametrize("kind", ["csv", "json", "txt", "yaml"])
def test_data_beside_a_module_is_a_part_of_its_code(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "tasks" / "toy"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text("from tasks.toy.words import WORDS\n")
    (folder / "words.py").write_text("WORDS = 1\n")
    monkeypatch.setattr(fingerprints, "ROOT", tmp_path)
    prints = set()
    for text in (None, "a", "b"):
        if text is not None:
            (folder / f"words.{kind}").write_text(text)
        forget()
        prints.add((fingerprints._fingerprint_of("tasks.toy"), fingerprints._contents_of_rooms()))
    assert [len(set(column)) for column in zip(*prints, strict=True)] == [3, 3]
    (folder / "words.md").write_text("no data")
    assert fingerprints._fingerprint_of("tasks.toy") in {first for first, _ in prints}
