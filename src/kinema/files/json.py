"""Read JSON back: size, encoding, depth and the types of what is needed are checked."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Any

from kinema.files.kinds import describe, refuse, require_file, size

MOST = 256 << 20
"""Bytes that a file may have: the largest of ours, a page with its motions, has a tenth of it."""

DEEP = 100
"""Levels that values may be nested."""

FIX = "write it again"


@dataclass(frozen=True)
class Each:
    """Say that a value is a dict whose values are all of one kind."""

    kind: Any


Kind = type | UnionType | Each | Mapping[str, Any]
"""What a value may be: a type or several (None: it may be left out), a dict of named kinds, or of one kind each."""

NUMBER = int | float
_NAMES = {dict: "an object", list: "a list", str: "a text", bool: "a truth value", type(None): "null"}


def read_json(path: str | Path, kind: Kind = dict, *, most: int = MOST, fix: str = FIX) -> Any:
    """Read a JSON file of a kind; raises FileNotFoundError, or ValueError naming file, what is wrong and `fix`."""
    path = require_file(path, fix)
    if (found := path.stat().st_size) > most:
        raise refuse(path, f"has {size(found)}, allowed: {size(most)}", fix)
    return parse_json(path.read_bytes(), path, kind, fix=fix)


def parse_json(content: bytes | str, where: str | Path, kind: Kind = dict, *, fix: str = FIX) -> Any:
    """Read JSON text of a kind; `where` names it in the error."""
    try:
        text = content if isinstance(content, str) else content.decode("utf-8-sig")
        value = json.loads(text)
        deep = _is_deep(value)
    except UnicodeDecodeError as error:
        raise refuse(where, f"is not UTF-8 (byte {error.start}: {error.object[error.start]:#04x})", fix) from None
    except RecursionError:
        deep = True
    except ValueError as error:
        head = content[:512].encode("utf-8", "replace") if isinstance(content, str) else content[:512]
        what = describe(head)
        what = f"is damaged (no JSON: {error})" if what == "is text" else f"{what}, not JSON"
        raise refuse(where, what, fix) from None
    if deep:
        raise refuse(where, f"is nested more than {DEEP} levels deep", fix)
    if wrong := fault(value, kind):
        raise refuse(where, wrong, fix)
    return value


def fault(value: Any, kind: Kind) -> str | None:
    """Say where a value isn't of a kind, None if it is."""
    if isinstance(kind, Each):
        kind = dict.fromkeys(value, kind.kind) if isinstance(value, dict) else dict
    if isinstance(kind, Mapping):
        if not isinstance(value, dict):
            return fault(value, dict)
        found = ((key, fault(value.get(key), inner)) for key, inner in kind.items())
        return next((f"has {key!r}: it {wrong}" for key, wrong in found if wrong), None)
    kinds = (kind,) if isinstance(kind, type) else kind.__args__
    # A truth value is an int to Python, and to nobody else.
    if any(isinstance(value, one) and isinstance(value, bool) == (one is bool) for one in kinds):
        return None
    return f"holds {_name(type(value))}, allowed: {' or '.join(dict.fromkeys(map(_name, kinds)))}"


def _name(kind: type) -> str:
    return _NAMES.get(kind, "a number" if kind in (int, float) else kind.__name__)


def _is_deep(value: Any) -> bool:
    level = [value]
    for _ in range(DEEP):
        level = [inner for one in level for inner in _inner(one)]
    return bool(level)


def _inner(value: Any) -> list[Any]:
    values = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return [inner for inner in values if isinstance(inner, dict | list)]
