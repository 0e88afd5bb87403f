"""``python -m flows.documentation``, part of `make pages`: writes the pages of settings and commands."""

from __future__ import annotations

from pathlib import Path

from flows.documentation.commands import commands_page
from flows.documentation.settings import configuration_page

if __name__ == "__main__":
    docs = Path(__file__).resolve().parents[2] / "docs"
    docs.joinpath("configuration.md").write_text(configuration_page())
    docs.joinpath("commands.md").write_text(commands_page())
