"""Goals that figures are held against."""

from __future__ import annotations

import operator
from typing import Any

_MET = {"<=": operator.le, ">=": operator.ge, "<": operator.lt, ">": operator.gt, "==": operator.eq}


def goal(name: str, value: float | int | None, sign: str, limit: float) -> dict[str, Any]:
    """A goal, what was found, what was wanted, and whether it is met; None where nothing was found."""
    return {"goal": name, "found": value, "wanted": f"{sign} {limit:g}", "met": None if value is None else bool(_MET[sign](value, limit))}
