"""A further member in every family, for interpreters with this folder on PYTHONPATH: a name at the end of the tuple, and a module.

Python imports it when it starts, so that workers have the members, too. `tests/test_families.py` asks what comes of it.
"""

from __future__ import annotations

import importlib
import sys
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path

HERE = Path(__file__).resolve().parent

MEMBERS = {
    "toy_scan": ("scan_formats", "SCAN_FORMATS", "tasks.capture"),
    "toy_export": ("export_formats", "EXPORT_FORMATS", "tasks.exports"),
    "toy_provider": ("candidate_providers", "CANDIDATE_PROVIDERS", "tasks.candidates"),
    "toy_finder": ("path_finders", "PATH_FINDERS", "tasks.navigation"),
    "toy_alignment": ("alignment_methods", "ALIGNMENT_METHODS", "tasks.alignment"),
    "toy_policy": ("policies", "POLICIES", "tasks.evaluation.policies"),
    "toy_method": ("selection_methods", "SELECTION_METHODS", "tasks.selection.methods"),
    "toy_system": ("learned_systems", "LEARNED_SYSTEMS", "tasks.training.systems"),
}
"""Names, the tuples that they are in, and the packages that their modules would lie in."""


class Finder:
    """Finds modules of the members here, as if they lay in the packages of the project."""

    @staticmethod
    def find_spec(fullname: str, path: object = None, target: object = None) -> ModuleSpec | None:
        for name, (_, _, package) in MEMBERS.items():
            if f"{fullname}.".startswith(f"{package}.{name}."):
                base = HERE.joinpath(*fullname.removeprefix(f"{package}.").split("."))
                if base.is_dir():
                    return spec_from_file_location(fullname, base / "__init__.py", submodule_search_locations=[str(base)])
                file = base.with_suffix(".py")
                return spec_from_file_location(fullname, file) if file.is_file() else None
        return None


sys.meta_path.insert(0, Finder)
for made_up, (module, variable, _) in MEMBERS.items():
    family = importlib.import_module(f"schemas.families.{module}")
    setattr(family, variable, (*getattr(family, variable), made_up))
