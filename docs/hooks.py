"""What mkdocs cannot do by itself: pages from the root of the repository, links to its files, and a page of the API per folder."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from posixpath import dirname, normpath, relpath
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[1]
ROOT_PAGES = {
    "README.md": "index.md",
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
    "CHANGELOG.md": "changelog.md",
    "GLOSSARY.md": "glossary.md",
}
"""Pages at the root of the repository, and where the site has them."""
ROOMS = ("schemas", "tasks", "warehouse", "flows")

_LINK = re.compile(r"\[(?P<label>(?:[^\[\]]|\[[^\[\]]*\])*)\]\((?P<target>[^()\s#:]+)(?P<anchor>#[^()\s]*)?\)")
_ATTRIBUTE = re.compile(r"\b(?P<name>src|href)=\"(?P<target>[^\"#:]+)(?P<anchor>#[^\"]*)?\"")
_FENCE = re.compile(r"^ *(?P<mark>```|~~~).*?^ *(?P=mark) *$", re.MULTILINE | re.DOTALL)
_CODE_WITH_BAR = re.compile(r"`[^`\n]*\\\|[^`\n]*`")


def on_config(config: Any) -> Any:
    """List the pages of the API in the navigation, and leave out pages that the repository has not."""
    config.nav = list(_present(config.nav))
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the pages of the root and of the API, and the files of the repository that pages link to."""
    from mkdocs.structure.files import File

    texts = {f"docs/{file.src_uri}": file.content_string for file in files.documentation_pages()}
    for name, place in ROOT_PAGES.items():
        if (REPOSITORY / name).is_file():
            texts[name] = (REPOSITORY / name).read_text()
            files.append(File.generated(config, place, content=texts[name]))
    for folder in api_folders():
        files.append(File.generated(config, api_page(folder), content=api_text(folder)))
    for path in sorted({path for origin, text in texts.items() for path in _linked(text, origin)}):
        if site_path(path).startswith("source/"):
            files.append(File.generated(config, site_path(path), abs_src_path=str(REPOSITORY / path)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """The page with links as the site has them."""
    place = page.file.src_uri
    return site_text(markdown, {place: name for name, place in ROOT_PAGES.items()}.get(place, f"docs/{place}"))


def site_path(path: str) -> str:
    """Where the site has a file of the repository."""
    if path in ROOT_PAGES:
        return ROOT_PAGES[path]
    return path.removeprefix("docs/") if path.startswith("docs/") and not path.endswith(".py") else f"source/{path}.txt"


def site_text(markdown: str, origin: str) -> str:
    """The page at the path `origin` of the repository as the site has it.

    Links to files of the repository lead to these files in the site; a folder is named without a link.
    """

    def moved(match: re.Match[str]) -> str:
        path = repository_path(match["target"], origin)
        if "label" in match.groupdict() and (REPOSITORY / path).is_dir():
            return match["label"]
        if not (REPOSITORY / path).is_file():
            return match[0]
        target = relpath(site_path(path), dirname(site_path(origin)) or ".") + (match["anchor"] or "")
        if "label" in match.groupdict():
            return f"[{_LINK.sub(moved, match['label'])}]({target})"
        return f'{match["name"]}="{target}"'

    def prose(text: str) -> str:
        text = _ATTRIBUTE.sub(moved, _LINK.sub(moved, text))
        return _CODE_WITH_BAR.sub(lambda match: match[0].replace("\\|", "|"), text)  # in code Markdown keeps the backslash

    parts, end = [], 0
    for fence in _FENCE.finditer(markdown):
        parts += [prose(markdown[end : fence.start()]), fence[0]]
        end = fence.end()
    return "".join([*parts, prose(markdown[end:])])


def repository_path(target: str, origin: str) -> str:
    """The path in the repository to which a link of the page at `origin` leads."""
    return normpath(f"{dirname(origin)}/{target}".lstrip("/"))


def links(markdown: str) -> Iterator[tuple[str, str]]:
    """Targets and anchors of the relative links of a page."""
    prose = _FENCE.sub("", markdown)
    for match in (*_LINK.finditer(prose), *_ATTRIBUTE.finditer(prose)):
        yield match["target"], match["anchor"] or ""
        if "label" in match.groupdict():
            yield from links(match["label"])


def _linked(markdown: str, origin: str) -> Iterator[str]:
    """Paths of the files of the repository that a page links to."""
    paths = (repository_path(target, origin) for target, _ in links(markdown))
    return (path for path in paths if (REPOSITORY / path).is_file())


def _present(entries: list[Any]) -> Iterator[Any]:
    """A navigation without what is not there. The entry `api` becomes that of the API."""
    for entry in entries:
        ((title, content),) = entry.items()
        if isinstance(content, list):
            yield {title: list(_present(content))}
        elif content == "api":
            yield {title: [{room: [{folder.replace("/", "."): api_page(folder)} for folder in api_folders(room)]} for room in ROOMS]}
        elif any(
            (REPOSITORY / name).is_file() for name in (f"docs/{content}", *(n for n, place in ROOT_PAGES.items() if place == content))
        ):
            yield entry


_BEHIND = "---\nsearch:\n  boost: 0.1\n---\n\n"
"""Pages of the API come behind those for people among what a search finds."""


def api_folders(*rooms: str) -> list[str]:
    """Folders of modules, a page each."""
    packages = (path.parent for room in rooms or ROOMS for path in sorted((REPOSITORY / room).rglob("__init__.py")))
    return [package.relative_to(REPOSITORY).as_posix() for package in packages]


def api_page(folder: str) -> str:
    """Where the site has the page of a folder."""
    return f"api/{folder.replace('/', '.')}.md"


def api_text(folder: str) -> str:
    """The page of a folder: what its docstring says, then its modules."""
    package = REPOSITORY / folder
    modules = [package / "__init__.py", *sorted(path for path in package.glob("*.py") if not path.stem.startswith("__"))]
    names = [".".join(path.relative_to(REPOSITORY).with_suffix("").parts).removesuffix(".__init__") for path in modules if _speaks(path)]
    return _BEHIND + "\n\n".join([f"# {folder.replace('/', '.')}", *(f"::: {name}" for name in names)]) + "\n"


def _speaks(path: Path) -> bool:
    """Whether a module has a docstring, without which there is nothing to show of it."""
    return ast.get_docstring(ast.parse(path.read_text())) is not None
