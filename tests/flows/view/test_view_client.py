"""The client: what it is made of, how it is built, and the file of one scene that it is put into."""

from __future__ import annotations

import base64
import gzip
import hashlib
import html.parser
import json
import re
from pathlib import Path
from urllib.parse import unquote

import pytest

from flows.view import bundle, standalone
from flows.view.scene import Scenes
from flows.view.standalone import write_page
from schemas.errors import InputError
from tests.conftest import REPOSITORY
from tests.flows.view.lakes import EVIL, OBJECTS, SCENES, shown_lake
from warehouse.lake import Lake

CLIENT = REPOSITORY / "flows" / "view" / "client"


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return shown_lake(tmp_path_factory.mktemp("client"))


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A client that was built, without three.js."""
    built = tmp_path / "built"
    built.mkdir()
    (built / "view.js").write_text('/* notice */ const end = "</script><!--"; console.log(end);')
    (built / "view.css").write_text("body { margin: 0 }")
    (built / "view.html").write_text("<!doctype html>")
    monkeypatch.setattr(bundle, "BUILT", built)
    return built


def test_the_lock_has_a_hash_of_everything_and_names_no_host() -> None:
    text = (CLIENT / "package-lock.json").read_text()
    packages = {name: facts for name, facts in json.loads(text)["packages"].items() if name}
    assert {name for name in packages if "@" not in name} == {"node_modules/three", "node_modules/esbuild"}
    assert all(re.fullmatch(r"sha512-[A-Za-z0-9+/]{86}==", facts["integrity"]) for facts in packages.values())
    assert "http" not in text
    assert "resolved" not in text
    asked = json.loads((CLIENT / "package.json").read_text())
    assert set(asked["dependencies"]) == {"three"}
    assert set(asked["devDependencies"]) == {"esbuild"}
    assert "ignore-scripts=true" in (CLIENT / ".npmrc").read_text(), "packages run nothing when they are fetched"


def test_no_module_of_the_client_reads_text_as_html_or_runs_it() -> None:
    forbidden = r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b|new Function|setTimeout\(\s*[\"'`]"
    modules = sorted((CLIENT / "src").rglob("*.js"))
    assert len(modules) > 20
    for module in modules:
        text = module.read_text()
        assert not re.search(forbidden, text), module
        assert "http" not in text, module
        assert text.count("\n") < 400


def test_files_of_the_client_are_named_and_nothing_else(stand_in: Path) -> None:
    (stand_in / "secret.txt").write_text("")
    (stand_in.parent / "view.js").write_text("")
    assert bundle.client_file("view.css") == b"body { margin: 0 }"
    for name in ("secret.txt", "../view.js", "no.js", "", ".", "view.js/", "/etc/passwd"):
        with pytest.raises(KeyError):
            bundle.client_file(name)


def test_a_client_that_was_not_built_is_said_to_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bundle, "BUILT", tmp_path)
    assert not bundle.is_built()
    with pytest.raises(InputError, match="make client"):
        bundle.client_file("view.html")


@pytest.mark.skipif(not bundle.is_built(), reason="`make client` has not been run")
def test_the_bundle_carries_the_notice_of_three_js() -> None:
    notice = (bundle.BUILT / "three.LICENSE").read_text()
    assert "MIT" in notice
    assert "three.js authors" in notice
    assert notice.strip() in bundle.client_file("view.js").decode()


class Elements(html.parser.HTMLParser):
    """Scripts of a page by id, with their texts, and everything else that it holds by name."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.scripts: dict[str, str] = {}
        self.kinds: dict[str, str | None] = {}
        self.others: list[str] = []
        self.policy = ""
        self._open: str | None = None
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.policy = (values.get("content") or "") if values.get("http-equiv") == "Content-Security-Policy" else self.policy
        if tag in ("script", "style"):
            self._open = values.get("id") or tag
            assert self._open not in self.scripts
            self.scripts[self._open], self.kinds[self._open] = "", values.get("type")
        else:
            self.others.append(tag)
        assert not any(name.startswith("on") or (name in ("src", "href") and value != "data:,") for name, value in attrs)

    def handle_data(self, data: str) -> None:
        if self._open:
            self.scripts[self._open] += data

    def handle_endtag(self, tag: str) -> None:
        self._open = None


@pytest.mark.parametrize("scene_id", SCENES)
def test_a_file_holds_all_that_the_page_asks_for(lake: Lake, stand_in: Path, tmp_path: Path, scene_id: str) -> None:
    scenes = Scenes(lake)
    size = write_page(scenes, scene_id, tmp_path / "sub" / "scene.html")
    text = (tmp_path / "sub" / "scene.html").read_bytes()
    assert len(text) == size
    page = Elements(text.decode())
    assert json.loads(page.scripts["api/scenes"])["first"] == scene_id
    document = json.loads(page.scripts[f"api/scenes/{scene_id}"])
    told = json.loads(json.dumps(scenes.shown(scene_id).document))
    assert document == told | {"frames": document["frames"]}
    assert not document["frames"]["rows"], "frames stay where the scan is"
    for row in document["objects"]:
        assert json.loads(page.scripts[f"api/scenes/{scene_id}/objects/{row['id']}"])["text"].startswith("snapshot ")
    blobs = {name.removeprefix("blobs/"): body for name, body in page.scripts.items() if name.startswith("blobs/")}
    shown = scenes.shown(scene_id)
    assert set(blobs) == {*shown.blobs, *shown.made}
    for name, body in blobs.items():
        assert hashlib.sha256(gzip.decompress(base64.b64decode(body))).hexdigest() == name.split(".")[0]
    assert len(document["objects"]) == OBJECTS


def test_a_file_runs_its_own_script_and_no_label(lake: Lake, stand_in: Path, tmp_path: Path) -> None:
    """By its policy; what a label says ends no element."""
    write_page(Scenes(lake), SCENES[1], tmp_path / "scene.html")
    text = (tmp_path / "scene.html").read_text()
    page = Elements(text)
    assert json.loads(page.scripts[f"api/scenes/{SCENES[1]}"])["objects"][0]["category"] == EVIL
    assert "img" not in page.others
    assert "b" not in page.others
    run = [name for name, kind in page.kinds.items() if kind is None]
    assert run == ["style", "script"]
    allowed = dict(part.split(" ", 1) for part in page.policy.split("; "))
    assert allowed["default-src"] == "'none'"
    for name, rule in (("script", "script-src"), ("style", "style-src")):
        assert allowed[rule] == f"'sha256-{base64.b64encode(hashlib.sha256(page.scripts[name].encode()).digest()).decode()}'"
    assert "http" not in page.policy


def test_the_same_snapshot_gives_the_same_file(lake: Lake, stand_in: Path, tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("one.html", "two.html")]
    for file in files:
        standalone.write_page_of(lake, lake.snapshot().snapshot_id, SCENES[0], file)
    assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.slow
@pytest.mark.whole
def test_a_report_links_a_page_for_every_scene_that_it_pictures(lake: Lake, stand_in: Path, tmp_path: Path) -> None:
    from flows.stats import write_report
    from tasks.stats.scenes import PictureConfig

    look = PictureConfig(width=200, height=140, oversampling=1)
    without = write_report(lake, tmp_path / "plain.html", look=look, workers=1).path.read_text()
    assert "Look at it in 3D" not in without
    text = write_report(lake, tmp_path / "report.html", pages=tmp_path / "some pages", look=look, workers=1).path.read_text()
    links = re.findall(r'<a href="([^"#]+)">Look at it in 3D', text)
    assert links == ["some%20pages/demo_room_0.html", "some%20pages/demo_room_1.html"]
    for scene_id, link in zip(SCENES, links, strict=True):
        assert f'id="api/scenes/{scene_id}"' in (tmp_path / unquote(link)).read_text()
