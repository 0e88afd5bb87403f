"""Small programs that stand in for those of others."""

from __future__ import annotations

import sys
from pathlib import Path


def program(folder: Path, body: str, name: str = "tool") -> str:
    """A Python program of some lines that can be run by its path."""
    path = folder / name
    path.write_text(f"#!{sys.executable}\nimport sys\n{body}\n")
    path.chmod(0o755)
    return str(path)
