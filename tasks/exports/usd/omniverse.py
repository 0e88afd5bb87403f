"""What NVIDIA's validator for Omniverse assets says of a USD file, in words of this project's gates.

The package `omniverse-asset-validator` (Apache-2.0) is optional: the extra `validator`.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any

from schemas.errors import InputError
from tasks.exports.findings import Finding

RULE = "omniverse"
"""The rule that its findings are reported under; the message begins with its own name of the rule that is broken."""


def check_omniverse(path: Path) -> list[Finding]:
    """Everything that the validator says, sorted. Its failures and errors are errors, the rest are warnings.

    Raises:
        InputError: the package is not installed, or stops.
    """
    validator = _validator()
    try:
        issues = list(validator.ValidationEngine().validate(str(path)).issues())
    except Exception as error:  # rules of others, on anybody's file
        raise InputError(path.name, "omniverse-asset-validator", f"stops: {_line(str(error), path)}") from error
    serious = (validator.IssueSeverity.ERROR, validator.IssueSeverity.FAILURE)
    findings = set()
    for issue in issues:
        if issue.severity == validator.IssueSeverity.NONE:
            continue
        name = getattr(issue.rule, "__name__", "?")
        findings.add(Finding(RULE, _where(issue.at, path), f"{name}: {_line(str(issue.message), path)}", issue.severity in serious))
    return sorted(findings)


def _validator() -> Any:
    """The package, without the log that it sets up on the standard output when it is imported."""
    root = logging.getLogger()
    silent = logging.NullHandler()
    root.addHandler(silent)  # a logger that has a handler is not set up again
    try:
        import omni.asset_validator as validator
    except ImportError as error:
        problem = f"is not installed ({error})"
        raise InputError("omniverse-asset-validator", "package", problem, "pip install omniverse-asset-validator==1.18.0") from error
    finally:
        root.removeHandler(silent)
    return validator


def _where(place: Any, path: Path) -> str:
    """The prim that something was found at, else the file's name."""
    for _ in range(4):
        if hasattr(place, "path"):
            return str(place.path)
        place = getattr(place, "prim_id", None)
        if place is None:
            break
    return path.name


def _line(text: str, path: Path) -> str:
    """A message in one line, with files named from the scene's folder."""
    plain = text.replace(f"{path.parent.resolve()}/", "").replace(f"{path.parent}/", "")
    return re.sub(r"\s+", " ", plain)[:300]
