"""Read a table's description, find its rows' results, and render them beside the published numbers."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from kinema.experiments.benchmark import sections
from kinema.experiments.breakdowns import Parts, breakdowns, footnotes
from kinema.experiments.config import compose
from kinema.experiments.corpus import corpus_label
from kinema.experiments.evaluation import Row, describe
from kinema.experiments.overrides import for_training, without_sampling
from kinema.experiments.provenance import Said, other_judges, provenance
from kinema.experiments.replications import EACH, over_replications, over_seeds
from kinema.experiments.sources import source_of
from kinema.experiments.spent import spent
from kinema.experiments.stages import stages
from kinema.experiments.table_files import PANELS

Results = dict[str, list[dict[str, Any]] | None]
"""Of every row, the metrics by replication: none where they are not all there, None where it isn't in Kinema."""


@dataclass(frozen=True)
class TableRow:
    """Hold one row: its description, its configuration and where its results are (None: no such method yet).

    A row of several training seeds is several of these, each with its `seed`; None is the caller's. `failure` says what
    kept it from being complete.
    """

    spec: dict[str, Any]
    cfg: DictConfig | None
    place: Row | None
    seed: int | None = None
    failure: str | None = None

    @property
    def overrides(self) -> list[str]:
        """The overrides that make it of the table's defaults."""
        return [*row_overrides(self.spec), *self._seed]

    @property
    def trained(self) -> list[str]:
        """Those of its overrides that change what is trained."""
        known = for_training(self.overrides)
        selects = self.cfg is not None and any(stage.selects(self.cfg) for stage in stages().values())
        return known if selects else without_sampling(known)

    @property
    def _seed(self) -> list[str]:
        return [] if self.seed is None else [f"seed={self.seed}"]

    @property
    def label(self) -> str:
        """Its label, and its seed where it has one of its own."""
        return self.spec["label"] if self.seed is None else f"{self.spec['label']} (seed {self.seed})"

    @property
    def said(self) -> Said:
        """What its results say of themselves."""
        return Said(self.spec["label"], self.label, self.lines)

    @property
    def lines(self) -> list[dict[str, Any]]:
        """The results by replication; none for a method that isn't in Kinema."""
        return [] if self.place is None else self.place.lines

    @property
    def complete(self) -> bool:
        """Say whether every replication has its line."""
        return self.place is not None and len(self.lines) == self.place.replications

    def explained(self, reasons: dict[Path, str]) -> TableRow:
        """Return the row with what kept it from being complete; `reasons` are by folder."""
        if self.place is None or self.complete:
            return self
        paths = (self.place.folder.path, *self.place.runs.values())
        why = next((reasons[path] for path in paths if path in reasons), None)
        return self if why is None else replace(self, failure=f"failed: {why}")


Group = list[TableRow]
"""One line of a table: a row, or one row for each of its training seeds."""


def grouped(rows: list[TableRow]) -> dict[str, Group]:
    """Return the table's lines by key."""
    groups: dict[str, Group] = {}
    for row in rows:
        groups.setdefault(row.spec["key"], []).append(row)
    return groups


def meant_for(table: dict[str, Any], overrides: list[str]) -> bool:
    """Say whether a table is about the corpus of the overrides; one that names no corpora in `only` is about any."""
    return "only" not in table or compose(overrides, "evaluate").data.name in table["only"]


def plan(table: dict[str, Any], overrides: list[str], seeds: int = 1) -> list[TableRow]:
    """Compose every row's configuration and find its folder; a row that is not for the corpus is left out.

    A row that scores what was trained comes once for each of so many training seeds, the caller's `seed` first.
    """
    rows: list[TableRow] = []
    overrides = [*overrides, *table.get("overrides", [])]
    for spec in table["rows"]:
        if "source" not in spec:
            rows.append(TableRow(spec, None, None))
            continue
        cfg = compose([*overrides, *row_overrides(spec)], "evaluate")
        if _is_for(spec, cfg):
            rows.append(TableRow(spec, cfg, describe(cfg)))
            rows += _further_seeds(rows[-1], overrides, seeds)
    return rows


def _is_for(spec: dict[str, Any], cfg: DictConfig) -> bool:
    """Say whether a row is for the corpus: of its `panel`, and for an oracle with labels."""
    panel = PANELS[cfg.data.skeleton]
    if spec.get("panel", panel) != panel:
        return False
    return source_of(cfg).suits(cfg)


def _further_seeds(first: TableRow, overrides: list[str], seeds: int) -> list[TableRow]:
    if first.cfg is None or first.place is None or not first.place.subject:
        return []
    found = []
    for seed in range(first.cfg.seed + 1, first.cfg.seed + seeds):
        row = replace(first, seed=seed)
        cfg = compose([*overrides, *row.overrides], "evaluate")
        place = describe(cfg)
        if place.digest != first.place.digest:  # else its run is a given one: another seed makes no other
            found.append(replace(row, cfg=cfg, place=place))
    return found


def row_overrides(spec: dict[str, Any]) -> list[str]:
    """Return the overrides that make a row of the defaults."""
    method = [f"method={spec['method']}"] if "method" in spec else []
    return [f"source={spec['source']}", *method, *spec.get("overrides", [])]


def render_table(table: dict[str, Any], rows: list[TableRow], out: Path, command: str) -> list[Path]:
    """Write the report of a table (report/site.py); an incomplete row's cells stay empty."""
    from kinema.experiments.cards import run_cards
    from kinema.report.motions import read_samples
    from kinema.report.site import render

    some = next(row.cfg for row in rows if row.cfg is not None)
    panel = PANELS[some.data.skeleton]
    published = table["paper"].get(panel, {})
    groups = grouped(rows)
    asked = {column["key"] for column in (*table["columns"], *table.get("beside", []))}
    found = {key: _results(group, asked) for key, group in groups.items()}
    results = with_borrowed([group[0] for group in groups.values()], found)
    shown = {key: group for key, group in groups.items() if group[0].spec.get("shown", True)}
    filled = {**table, "rows": [_filled(group, published, results[key]) for key, group in shown.items()]}
    compared = {key for effect in table.get("effects", ()) for key in effect["columns"]}
    for row, group in zip(filled["rows"], shown.values(), strict=True):
        row["draws"] = _draws(group, compared)
    filled.pop("paper")
    filled["panel"] = panel if published else None
    filled["comparable"] = some.data.paper == panel and some.scale.name == "paper"
    filled["corpus"] = corpus_label(some)
    filled["scale"] = some.scale.name
    said = [row.said for row in rows if row.complete]
    filled["provenance"] = provenance(said, command)
    filled["runs"] = run_cards(rows)
    parts = [
        Parts(group[0].spec, [row.lines for row in group])
        for key, group in shown.items()
        if results[key] and "metrics" not in group[0].spec
    ]
    filled["breakdowns"] = [*sections(filled.pop("beside", []), filled["rows"]), *breakdowns(parts)]
    filled["footnotes"] = [*table.get("footnotes", []), *footnotes(parts), *other_judges(said)]
    motions = {
        key: read_samples(row.place.folder.path / "samples.npz")
        for key, (row, *_) in shown.items()
        if row.place is not None and results[key] and "metrics" not in row.spec
    }
    return render(filled, out, {k: v for k, v in motions.items() if v})


def with_borrowed(rows: list[TableRow], results: Results) -> Results:
    """Give rows the metrics that they borrow from another row, replication by replication (or seed by seed).

    `borrow: {row: KEY, metrics: {name here: name there}}`; a row with `shown: false` is there to be borrowed from.
    """
    found = dict(results)
    for row in rows:
        key, borrow = row.spec["key"], row.spec.get("borrow")
        own = results[key]
        if not borrow or not own:
            continue
        if borrow["row"] not in results:
            raise ValueError(f"row {key!r} borrows from {borrow['row']!r}, which is no row; rows: {', '.join(results)}")
        if lent := results[borrow["row"]]:
            taken = [{here: line[there] for here, there in borrow["metrics"].items() if there in line} for line in lent]
            if len(lent) != len(own):
                raise ValueError(
                    f"row {key!r} has {len(own)} results and {borrow['row']!r} {len(lent)}: none to borrow"
                )
            found[key] = [{**line, **more} for line, more in zip(own, taken, strict=True)]
    return found


def _results(group: Group, asked: Collection[str]) -> list[dict[str, Any]] | None:
    """Return the metrics by replication, or of several training seeds the means by seed.

    It is an empty list where one is missing, None where the method isn't in Kinema.
    """
    if group[0].place is None:
        return None
    if not all(row.complete for row in group):
        return []
    renamed = group[0].spec.get("metrics")
    found = over_seeds([_lines(row, asked) for row in group])
    return [{key: m[name] for key, name in renamed.items()} for m in found] if renamed else found


def _lines(row: TableRow, asked: Collection[str]) -> list[dict[str, Any]]:
    """Return a row's metrics by replication, and of what was timed and what its runs cost that which is asked for."""
    if row.place is None:
        return []
    cost = spent(row.place)
    beside = [{**cost, **({EACH: line[EACH]} if EACH in line else {})} for line in row.lines]
    return [
        {**line["metrics"], **{key: value for key, value in more.items() if key in asked}}
        for line, more in zip(row.lines, beside, strict=True)
    ]


def _draws(group: Group, compared: Collection[str]) -> list[dict[str, Any]] | None:
    """Return the metrics that effects compare, by replication over all training seeds; None for a single one."""
    if len(group) == 1 or "metrics" in group[0].spec or not all(row.complete for row in group):
        return None
    found = over_replications([[line["metrics"] for line in row.lines] for row in group])
    return [{key: metrics[key] for key in compared if key in metrics} for metrics in found]


def _filled(group: Group, published: dict[str, Any], results: list[dict[str, Any]] | None) -> dict[str, Any]:
    row, spec = group[0], group[0].spec
    notes = (*(one.spec.get("note") for one in group), *(one.failure for one in group), *_notes(row))
    return {
        "key": spec["key"],
        "label": spec["label"],
        "kind": spec["kind"],
        "note": "; ".join(dict.fromkeys(note for note in notes if note)),
        "cannot": spec.get("cannot"),
        "published": published.get(spec["key"]),
        "results": results,
        "seeds": len(group) if len(group) > 1 else None,
    }


def _notes(row: TableRow) -> tuple[str, ...]:
    """Say what of the row's making a reader can't see in its label."""
    if (cfg := row.cfg) is None:
        return ()
    return (
        *source_of(cfg).notes(cfg),
        "redundant dims recomputed from the joints" if cfg.lift else "",
        "feet held" if cfg.lock_feet else "",
        "" if cfg.precision == "float32" else f"products in {cfg.precision}",
    )
