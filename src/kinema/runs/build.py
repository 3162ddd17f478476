"""Build objects from plain nested dicts, the one format that configs and saved weights share.

A spec is `{"_target_": "kinema.tokenizers.autoencoder.AutoEncoder", ...arguments}`; nested specs are built first.
Only classes marked `@buildable` are built, so that a spec read from a file cannot name arbitrary code.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from kinema import options
from kinema.registry import find_class


def build(spec: Any, *, at: str = "", **extra: Any) -> Any:
    """Build what a spec describes; `extra` adds or replaces arguments of the outermost target.

    `at` is the key that the spec stands under, which errors name (without one, the class). Raises ValueError for a
    target that isn't marked as buildable, unknown arguments, or values that an argument's annotation doesn't allow,
    before anything takes memory.
    """
    if isinstance(spec, Mapping) and "_target_" in spec:
        target = find_class(spec["_target_"])
        given = {k: v for k, v in spec.items() if k != "_target_"} | extra
        where = at or target.__name__
        try:
            inspect.signature(target).bind(**given)
        except TypeError as error:
            allowed = ", ".join(inspect.signature(target).parameters)
            raise ValueError(f"{at or spec['_target_']}: {error}; its arguments are: {allowed}") from None
        options.check(target, {k: v for k, v in given.items() if not isinstance(v, Mapping)}, where)
        arguments = {k: build(v, at=f"{where}.{k}") for k, v in given.items()}
        options.check(target, arguments, where)
        return target(**arguments)
    if isinstance(spec, Mapping):
        return {k: build(v, at=at and f"{at}.{k}") for k, v in spec.items()}
    if isinstance(spec, list | tuple):
        return [build(v, at=at) for v in spec]
    return spec
