"""Colors of lake and export GLBs in a browser: three.js' own reader, and the viewer's."""

from __future__ import annotations

import mimetypes
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from flows.view.bundle import BUILT
from tasks import exports
from tasks.exports.glb import glb_files
from tasks.geometry.meshes import dump_glb, load_glb
from tests.conftest import REPOSITORY
from tests.flows.view.test_view_browser import browser
from tests.replicas import Object, replica_of, rows_of, translation
from tests.tasks.geometry.colored import COLORED

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route

pytestmark = pytest.mark.whole

__all__ = ["browser"]

PACKAGES = REPOSITORY / ".venv" / "client" / "node_modules" / "three"
SOURCES = REPOSITORY / "flows" / "view" / "client" / "src"
HOME = "http://colors.invalid/"
MAX_DIFFERENCE = 2.0
"""Of 255: each border rounds once."""

PAGE = """<!doctype html><script type="importmap">
{"imports": {"three": "./three/build/three.module.js", "three/addons/": "./three/examples/jsm/"}}
</script><script type="module">
import * as three from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { model, unlit } from "./src/models.js";

const renderer = new three.WebGLRenderer({ preserveDrawingBuffer: true });
renderer.setSize(32, 32, false);

/** The color in the middle of each object of that name, without light. */
function seen(root, names, unlit) {
  root.traverse((node) => { if (node.isMesh) node.material = unlit(node.material); });
  const scene = new three.Scene().add(root);
  const gl = renderer.getContext();
  return names.map((name) => {
    const thing = name === null ? root : root.getObjectByName(name);
    const box = new three.Box3().setFromObject(thing);
    const middle = box.getCenter(new three.Vector3());
    const camera = new three.PerspectiveCamera(20, 1, 0.01, 10);
    camera.position.copy(middle).add(new three.Vector3(0.4, 0.7, 0.6));
    camera.lookAt(middle);
    renderer.render(scene, camera);
    const pixel = new Uint8Array(4);
    gl.readPixels(16, 16, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    return [...pixel.slice(0, 3)];
  });
}

const plain = ({ color, map, vertexColors }) => new three.MeshBasicMaterial({ color, map, vertexColors });
window.byThree = async (file, names) => {
  const { scene } = await new GLTFLoader().loadAsync(file);
  return seen(scene, names, plain);
};
window.byViewer = async (file) => seen(await model(file), [null], unlit);
document.documentElement.dataset.ready = "yes";
</script>"""

SOURCE = "export const source = { bytes: async (name) => (await fetch(`./${name}`)).arrayBuffer() };"


@pytest.fixture(scope="module")
def files() -> dict[str, bytes]:
    """Foreign GLBs, the same as assets of the lake, and an exported scene of all."""
    parts = [load_glb(made.glb()) for made in COLORED]
    places = [translation([-2.5 + 0.6 * (index % 6), -1.5 + 0.6 * (index // 6), 0.0]) for index in range(len(parts))]
    objects = [Object("box", each, each, pose) for each, pose in zip(parts, places, strict=True)]
    (scene,) = glb_files(replica_of(*rows_of(objects)), exports.ExportsConfig())
    foreign = {f"foreign_{index}.glb": made.glb() for index, made in enumerate(COLORED)}
    return {"scene.glb": scene.data, **foreign, **{f"asset_{index}.glb": dump_glb(each) for index, each in enumerate(parts)}}


@pytest.fixture(scope="module")
def page(browser: Browser, files: dict[str, bytes]) -> Iterator[Page]:
    if not (BUILT / "view.js").exists() or not PACKAGES.is_dir():
        pytest.skip("the client was not built: make client")
    wrong: list[str] = []

    def answer(route: Route) -> None:
        path = urlsplit(route.request.url).path.removeprefix("/")
        made: Any = files.get(path, {"": PAGE, "src/source.js": SOURCE}.get(path))
        if made is None and path.startswith(("three/", "src/")):
            folder, _, rest = path.partition("/")
            file = Path(PACKAGES if folder == "three" else SOURCES, rest)
            made = file.read_bytes() if file.is_file() else None
        kind = mimetypes.guess_type(path)[0] or "text/html"
        if made is None and path != "favicon.ico":
            wrong.append(path)
        route.fulfill(status=404 if made is None else 200, body=made or b"", content_type=kind)

    opened = browser.new_page()
    opened.on("pageerror", lambda error: wrong.append(str(error)))
    opened.route("**/*", answer)
    opened.goto(HOME)
    opened.wait_for_selector("html[data-ready=yes]", state="attached")
    yield opened
    opened.close()
    assert wrong == []


def agree(found: list[list[int]]) -> None:
    """Each box shows its color. found: sRGB, shape (n, 3)."""
    for color, made in zip(found, COLORED, strict=True):
        assert np.abs(np.array(color) - made.displayed).max() <= MAX_DIFFERENCE, (made.name, color, made.displayed)


def test_an_exported_scene_shows_its_colors_in_three_js(page: Page) -> None:
    names = [f"box_{index + 1:04d}" for index in range(len(COLORED))]
    agree(page.evaluate("names => byThree('scene.glb', names)", names))


def test_assets_of_the_lake_show_their_colors_in_three_js_and_in_the_viewer(page: Page) -> None:
    for judge in ("byThree(`asset_${index}.glb`, [null])", "byViewer(`asset_${index}.glb`)"):
        agree([page.evaluate(f"async (index) => (await {judge})[0]", index) for index in range(len(COLORED))])


def test_three_js_sees_foreign_files_as_the_project_does(page: Page) -> None:
    """Light alone and gloss are left out: three.js draws the base color, black or white, and reads no gloss."""
    for index, made in enumerate(COLORED):
        (color,) = page.evaluate("index => byThree(`foreign_${index}.glb`, [null])", index)
        if made.light is None and not made.is_glossy:
            assert np.abs(np.array(color) - made.displayed).max() <= MAX_DIFFERENCE, (made.name, color)
