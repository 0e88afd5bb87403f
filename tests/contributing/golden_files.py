"""Golden files and generated pages, written anew after a change on purpose: `make golden`.

What was made by other programs, or by earlier versions of this one, is evidence and stays: navmeshes, earlier lakes, deployments.
"""

from __future__ import annotations

import json
from pathlib import Path

from flows.documentation.commands import commands_page
from flows.documentation.settings import configuration_page
from tests.conftest import REPOSITORY
from tests.flows.run.test_configuration import IDENTITIES, identities
from tests.schemas import test_schemas as schemas
from tests.warehouse.questions import test_catalog as catalog
from warehouse.questions.catalog import empty_lake, views_page
from warehouse.questions.documentation import tables_page
from warehouse.questions.reads import reads_page

DOCS = REPOSITORY / "docs"


def golden_files() -> dict[Path, str]:
    """All that is generated, by file.

    Raises:
        SystemExit: columns of a view, or parameters of a macro, changed, and its version did not.
    """
    files = {schemas.GOLDEN / f"{name}.json": as_json(schemas.described(table)) for name, table in schemas.TABLES.items()}
    with empty_lake() as lake:
        views = {catalog.GOLDEN / f"{name}.json": catalog.described(lake, asked) for name, asked in catalog.ASKED.items()}
    for file, view in views.items():
        problem = catalog.difference(json.loads(file.read_text()), view) if file.exists() else None
        if problem and "raise the version" in problem:
            raise SystemExit(problem)
        files[file] = as_json(view)
    files[IDENTITIES] = as_json(identities())
    pages = {"tables.md": tables_page(), "views.md": views_page(), "reads.md": reads_page()}
    pages |= {"configuration.md": configuration_page(), "commands.md": commands_page()}
    return files | {DOCS / name: page for name, page in pages.items()}


def as_json(value: object) -> str:
    return json.dumps(value, indent=1, ensure_ascii=False) + "\n"


def write_golden_files() -> list[Path]:
    """Write what changed, and remove what belongs to no table, view or macro any more. The files, sorted."""
    files = golden_files()
    gone = [path for folder in (schemas.GOLDEN, catalog.GOLDEN) for path in folder.glob("*.json") if path not in files]
    changed = [path for path, text in files.items() if not path.exists() or path.read_text() != text]
    for path in changed:
        path.write_text(files[path])
    for path in gone:
        path.unlink()
    return sorted(changed + gone)


if __name__ == "__main__":
    for path in write_golden_files():
        print(path.relative_to(REPOSITORY))
