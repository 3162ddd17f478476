"""Read conf/table: what a table's file may say, checked before anything is composed or trained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from omegaconf import OmegaConf

from kinema.experiments.config import CONF, plain
from kinema.options import Number, OneOf, Options, make
from kinema.report.cells import ARROWS, KINDS
from kinema.report.intervals import FORMS

Cell = float | int | str | Sequence[float | int] | None
"""A published number, with its interval as printed where it has one."""


@dataclass(frozen=True)
class Column(Options):
    """Say which metric stands in a column, and how."""

    key: str
    label: str
    better: Annotated[str, OneOf(ARROWS)] = "none"
    digits: Number = 3
    flag: Mapping[str, float | str] | None = None


@dataclass(frozen=True)
class Line(Options):
    """Say what a row scores: a `source` with overrides; without one, a method that Kinema can't run.

    `borrow` takes metrics from another row; `metrics` gives its own another name; `shown: false` is only borrowed from.
    """

    key: str
    kind: Annotated[str, OneOf(KINDS)]
    label: str
    source: str | None = None
    method: str | None = None
    overrides: Sequence[str] = ()
    note: str | None = None
    cannot: str | None = None
    panel: str | None = None
    shown: bool = True
    metrics: Mapping[str, str] | None = None
    borrow: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Comparison(Options):
    """Say which rows an effect compares, and in which columns."""

    what: str
    row: str
    than: str
    columns: Sequence[str]


@dataclass(frozen=True)
class TableFile(Options):
    """Say what a table is of. `paper` holds published numbers by corpus, row and column."""

    name: str
    title: str
    columns: Sequence[Mapping[str, Any]]
    rows: Sequence[Mapping[str, Any]]
    beside: Sequence[Mapping[str, Any]] = ()
    effects: Sequence[Mapping[str, Any]] = ()
    overrides: Sequence[str] = ()
    paper: Mapping[str, Mapping[str, Mapping[str, Cell]]] | None = None
    only: Sequence[str] | None = None
    footnotes: Sequence[str] = ()
    mark_best: bool = True
    intervals: Annotated[str, OneOf(FORMS)] = "student"


PANELS = {"humanml3d": "humanml3d", "kit": "kit_ml"}
"""The panel of a paper's table that shows motion of a skeleton."""
PARTS: dict[str, type[Options]] = {"columns": Column, "beside": Column, "rows": Line, "effects": Comparison}


def load_table(name: str) -> dict[str, Any]:
    """Read conf/table/NAME.yaml; a table `like` another has of it what its own file doesn't say.

    Raises FileNotFoundError naming the tables there are, and ValueError naming what is misspelt, wrong, missing or
    there twice.
    """
    table = {"paper": {}, **_read(name)}
    file = f"conf/table/{name}.yaml"
    make(TableFile, table, file)
    for part, kind in PARTS.items():
        for row in table.get(part, ()):
            make(kind, row, f"{file} {part} {row.get('key', row.get('what', ''))}".rstrip())
    for panel in PANELS.values():
        keys = [row["key"] for row in table["rows"] if row.get("panel", panel) == panel]
        if twice := next((key for key in keys if keys.count(key) > 1), None):
            raise ValueError(f"{file}: two of its rows have the key {twice!r}; give each its own, or another panel")
    return table


def _read(name: str) -> dict[str, Any]:
    path = CONF / "table" / f"{name}.yaml"
    if not path.exists():
        known = ", ".join(sorted(p.stem for p in path.parent.glob("*.yaml")))
        raise FileNotFoundError(f"there is no table {name!r}; tables: {known}")
    own = plain(OmegaConf.load(path))
    return {**_read(own.pop("like")), **own} if "like" in own else own
