"""Find what stands in a package, one file each: a module put there is known without another edit."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable
from typing import TypeVar

Kind = TypeVar("Kind")


def discover(package: str, folders: Iterable[str], kind: type[Kind], word: str) -> dict[str, Kind]:
    """Make one of each class of a kind that has a `name` of its own, by that name; `word` is what errors call it.

    Raises ValueError where two have one name.
    """
    found: dict[str, Kind] = {}
    for entry in pkgutil.iter_modules(list(folders), f"{package}."):
        for one in vars(importlib.import_module(entry.name)).values():
            if isinstance(one, type) and issubclass(one, kind) and "name" in vars(one):
                name = vars(one)["name"]
                other = found.setdefault(name, one())
                if type(other) is not one:
                    raise ValueError(f"{one} and {type(other)} are both {word} {name!r}; rename one of them")
    return found
