"""three.js in a browser as a judge: its own loaders, with poses, colors and textures as its shaders compute them."""

from __future__ import annotations

import base64
import mimetypes
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, unquote, urlsplit

import numpy as np

from bench.files.judges import PATIENCE_SECONDS, Verdict
from bench.files.measure import ModelPart, measure
from bench.viewer import BROWSERS, browser_without_gpu
from schemas.files import stays_in

if TYPE_CHECKING:
    from playwright.sync_api import Route

PACKAGES = Path(sys.prefix) / "client" / "node_modules" / "three"
"""three.js, where `make client` puts it."""

ENDINGS = (".gltf", ".glb", ".obj", ".ply")
HOME = "http://judge.invalid/"

__all__ = ["BROWSERS", "ENDINGS", "PACKAGES", "threejs"]


@contextmanager
def threejs(corpus: Path) -> Iterator[Callable[[Path], Verdict]]:
    """A function that reads a file below the folder `corpus` by three.js.

    Raises:
        InputError: the machine has no browser, or no package to drive one.
    """

    def answer(route: Route) -> None:
        path = unquote(urlsplit(route.request.url).path).removeprefix("/")
        kind, _, rest = path.partition("/")
        root = {"three": PACKAGES, "corpus": corpus}.get(kind)
        file = Path(__file__).with_name("judge.html") if not path else None
        if root is not None and stays_in(root / rest, root):
            file = root / rest
        is_there = file is not None and file.is_file()
        body = file.read_bytes() if file is not None and is_there else b""
        route.fulfill(status=200 if is_there else 404, body=body, content_type=mimetypes.guess_type(path or "judge.html")[0])

    with browser_without_gpu() as browser:
        page = browser.new_page()
        page.set_default_timeout(1000 * PATIENCE_SECONDS)
        page.route("**/*", answer)
        page.goto(HOME)
        page.wait_for_selector("html[data-ready=yes]", state="attached")

        def read(path: Path) -> Verdict:
            from playwright.sync_api import Error

            address = "./corpus/" + quote(path.relative_to(corpus).as_posix())
            try:
                return measure([_part(values) for values in page.evaluate("address => judged(address)", address)])
            except (Error, ValueError, IndexError) as error:
                return f"reads nothing ({' '.join(str(error).split())})"[:120]

        yield read


def _part(values: Any) -> ModelPart:
    def array(name: str, kind: str, width: int) -> Any:
        return None if values[name] is None else np.frombuffer(base64.b64decode(values[name]), kind).reshape(-1, width)

    image = array("pixels", "<u1", 4)
    if image is not None:
        width, height = values["size"]
        image = image.reshape(height, width, 4)[:, :, :3]
    return ModelPart(
        array("positions", "<f8", 3), array("faces", "<u4", 3).astype(np.int64),
        factor=None if values["factor"] is None else np.array(values["factor"], dtype=np.float64),
        colors=array("colors", "<f4", 3), uv=array("uv", "<f4", 2), image=image, wraps=tuple(values["wraps"]),
    )  # fmt: skip
