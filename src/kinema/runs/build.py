"""Build objects from plain nested dicts, the one format that configs and saved weights share.

A spec is `{"_target_": "kinema.tokenizers.autoencoder.AutoEncoder", ...arguments}`; nested specs are built first.
Only classes below trusted packages are built, so that a spec read from a file cannot name arbitrary code.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Mapping
from typing import Any

TRUSTED = ("kinema.",)


def build(spec: Any, *, trusted: tuple[str, ...] = TRUSTED, **extra: Any) -> Any:
    """Build what a spec describes; `extra` adds or replaces arguments of the outermost target.

    Raises ValueError for a target outside the trusted packages, one that is no class, or unknown arguments.
    """
    if isinstance(spec, Mapping):
        arguments = {k: build(v, trusted=trusted) for k, v in spec.items() if k != "_target_"}
        if "_target_" not in spec:
            return arguments
        target = locate(str(spec["_target_"]), trusted)
        arguments |= extra
        try:
            inspect.signature(target).bind(**arguments)
        except TypeError as error:
            allowed = ", ".join(inspect.signature(target).parameters)
            raise ValueError(f"{spec['_target_']}: {error}; its arguments are: {allowed}") from None
        return target(**arguments)
    if isinstance(spec, list | tuple):
        return [build(v, trusted=trusted) for v in spec]
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
