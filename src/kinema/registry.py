"""Know which classes a description may build: those that say so themselves.

A description, `{"_target_": path, ...arguments}`, stands in configurations and in weights that come from elsewhere.
"""

from __future__ import annotations

import importlib
import sys
from typing import TypeVar

PACKAGE = "kinema."
_CLASSES: set[type] = set()

Class = TypeVar("Class", bound=type)


def buildable(cls: Class) -> Class:
    """Mark a class as one that a description may build; its subclasses are marked by themselves.

    Who marks a class says that making one only computes: it reads and writes no file and asks no network, whatever the
    arguments.
    """
    _CLASSES.add(cls)
    return cls


def find_class(path: object) -> type:
    """Return the class that is marked as buildable and found at a dotted path.

    Modules of kinema are imported for it, those of others must have been: a file can't choose what code runs.
    Raises ValueError for any other path.
    """
    module, _, name = str(path).rpartition(".")
    found = _members(module).get(name)
    if not isinstance(found, type) or found not in _CLASSES:
        raise ValueError(
            f"_target_={path!r} can't be built from a description: it is no class that is marked @buildable; check the "
            "spelling, and if it is of a package of your own, import that first"
        )
    return found


def _members(module: str) -> dict[str, object]:
    """Return what stands in a module; nothing if there is none, or none that may be imported."""
    if module not in sys.modules and module.startswith(PACKAGE) and "__" not in module:
        try:
            importlib.import_module(module)
        except ImportError:
            return {}
    return vars(sys.modules[module]) if module in sys.modules else {}
