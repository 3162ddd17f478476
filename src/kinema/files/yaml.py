"""Check YAML before anything is built from it: an alias can unfold to more than a machine holds."""

from __future__ import annotations

from pathlib import Path

import yaml

from kinema.files.kinds import refuse
from kinema.files.text import read_text

MOST = 16 << 20
DEEP = 100
FIX = "write it again"


def read_yaml(path: str | Path, *, fix: str = FIX) -> str:
    """Return the text of a YAML file that is one mapping of plain data without aliases, at most 100 levels deep.

    Raises FileNotFoundError, or ValueError naming the file, what is wrong and `fix`.
    """
    text = read_text(path, most=MOST, fix=fix)
    try:
        wrong = _fault(text)
    except yaml.YAMLError as error:
        raise refuse(path, f"is no YAML ({error})", fix) from None
    if wrong is not None:
        raise refuse(path, wrong, fix)
    return text


def _fault(text: str) -> str | None:
    """Read the events alone, which builds nothing."""
    level, documents, nodes = 0, 0, 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        nodes += isinstance(event, yaml.NodeEvent)
        documents += isinstance(event, yaml.DocumentStartEvent)
        level += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if isinstance(event, yaml.AliasEvent):
            return f"has an alias (*{event.anchor}); write the values out"
        if isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent) and event.tag not in (None, "!"):
            return f"has the tag {event.tag}; only plain values are read"
        if nodes == 1 and isinstance(event, yaml.NodeEvent) and not isinstance(event, yaml.MappingStartEvent):
            return "is no mapping of names to values"
        if level > DEEP or documents > 1:
            return f"is nested more than {DEEP} levels deep" if level > DEEP else "holds several documents"
    return None if nodes else "is empty"
