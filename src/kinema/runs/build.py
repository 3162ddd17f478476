"""Build objects from plain nested dicts, the one format that configs and saved weights share.

A spec is `{"_target_": "kinema.tokenizers.autoencoder.AutoEncoder", ...arguments}`; nested specs are built first.
Only classes below trusted packages are built, so that a spec read from a file cannot name arbitrary code.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Mapping
from typing import Any

from kinema import options

TRUSTED = ("kinema.",)


def build(spec: Any, *, trusted: tuple[str, ...] = TRUSTED, at: str = "", **extra: Any) -> Any:
    """Build what a spec describes; `extra` adds or replaces arguments of the outermost target.

    `at` is the key that the spec stands under, which errors name (without one, the class). Raises ValueError for a
    target outside the trusted packages, one that is no class, unknown arguments, or values that an argument's
    annotation doesn't allow, before anything takes memory.
    """
    if isinstance(spec, Mapping) and "_target_" in spec:
        target = locate(str(spec["_target_"]), trusted)
        given = {k: v for k, v in spec.items() if k != "_target_"} | extra
        where = at or target.__name__
        try:
            inspect.signature(target).bind(**given)
        except TypeError as error:
            allowed = ", ".join(inspect.signature(target).parameters)
            raise ValueError(f"{at or spec['_target_']}: {error}; its arguments are: {allowed}") from None
        options.check(target, {k: v for k, v in given.items() if not isinstance(v, Mapping)}, where)
        arguments = {k: build(v, trusted=trusted, at=f"{where}.{k}") for k, v in given.items()}
        options.check(target, arguments, where)
        return target(**arguments)
    if isinstance(spec, Mapping):
        return {k: build(v, trusted=trusted, at=at and f"{at}.{k}") for k, v in spec.items()}
    if isinstance(spec, list | tuple):
        return [build(v, trusted=trusted, at=at) for v in spec]
    return spec


def locate(path: str, trusted: tuple[str, ...] = TRUSTED) -> type:
    """Find a class by its dotted path below a trusted package."""
    if not path.startswith(trusted):
        raise ValueError(f"target {path!r} is outside the trusted packages {trusted}; pass trusted=(...) to allow it")
    module, _, name = path.rpartition(".")
    try:
        found = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError):
        raise ValueError(f"target {path!r} does not exist; check the spelling of `_target_`") from None
    if not inspect.isclass(found):
        raise ValueError(f"target {path!r} is not a class")
    return found
