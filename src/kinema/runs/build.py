"""Build objects from plain nested dicts, the one format that configs and saved weights share.

A spec is `{"_target_": "kinema.tokenizers.autoencoder.AutoEncoder", ...arguments}`; nested specs are built first.
Only classes marked `@buildable` are built, so that a spec read from a file cannot name arbitrary code.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from kinema.registry import find_class


def build(spec: Any, **extra: Any) -> Any:
    """Build what a spec describes; `extra` adds or replaces arguments of the outermost target.

    Raises ValueError for a target that isn't marked as buildable, or unknown arguments.
    """
    if isinstance(spec, Mapping):
        if "_target_" not in spec:
            return {k: build(v) for k, v in spec.items()}
        target = find_class(spec["_target_"])
        arguments = {k: build(v) for k, v in spec.items() if k != "_target_"} | extra
        try:
            inspect.signature(target).bind(**arguments)
        except TypeError as error:
            allowed = ", ".join(inspect.signature(target).parameters)
            raise ValueError(f"{spec['_target_']}: {error}; its arguments are: {allowed}") from None
        return target(**arguments)
    if isinstance(spec, list | tuple):
        return [build(v) for v in spec]
    return spec
