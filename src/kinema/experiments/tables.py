"""Read a table's description, find its rows' results, and render them beside the published numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from kinema.experiments.config import CONF, compose, plain
from kinema.experiments.evaluation import Row, describe

WITH_OPTIONS = ("data", "scale", "text", "seed", "trainer", "evaluator", "paths", "debug")
"""Config groups that a table takes from its caller; the rest is the table's own."""

PANELS = {"humanml3d": "humanml3d", "kit": "kit_ml"}
"""The panel of a paper's table that shows motion of a skeleton."""


Results = dict[str, list[dict[str, Any]] | None]
"""Of every row, the metrics by replication: none where they are not all there, None where it isn't in Kinema."""


@dataclass(frozen=True)
class TableRow:
    """Hold one row: its description, its configuration and where its results are (None: no such method yet)."""

    spec: dict[str, Any]
    cfg: DictConfig | None
    place: Row | None

    @property
    def lines(self) -> list[dict[str, Any]]:
        """The results by replication; none for a method that isn't in Kinema."""
        return [] if self.place is None else self.place.lines

    @property
    def complete(self) -> bool:
        """Say whether every replication has its line."""
        return self.place is not None and len(self.lines) == self.place.replications

    def explained(self, reasons: dict[Path, str]) -> TableRow:
        """Return the row with what kept it from being complete in its note; `reasons` are by folder."""
        if self.place is None or self.complete:
            return self
        paths = (self.place.folder.path, *self.place.runs.values())
        why = next((reasons[path] for path in paths if path in reasons), None)
        if why is None:
            return self
        notes = [note for note in (self.spec.get("note"), f"failed: {why}") if note]
        return replace(self, spec={**self.spec, "note": "; ".join(notes)})


def load_table(name: str) -> dict[str, Any]:
    """Read conf/table/NAME.yaml; raises FileNotFoundError naming the tables there are."""
    path = CONF / "table" / f"{name}.yaml"
    if not path.exists():
        known = ", ".join(sorted(p.stem for p in path.parent.glob("*.yaml")))
        raise FileNotFoundError(f"there is no table {name!r}; tables: {known}")
    return plain(OmegaConf.load(path))


def benchmark_columns() -> list[dict[str, Any]]:
    """Read the columns that every table shows beside its own."""
    return plain(OmegaConf.load(CONF / "benchmark.yaml"))["columns"]


def plan(table: dict[str, Any], overrides: list[str]) -> list[TableRow]:
    """Compose every row's configuration and find its folder; a row of the other `panel` is left out."""
    rows = []
    overrides = [*overrides, *table.get("overrides", [])]
    for spec in table["rows"]:
        if "source" not in spec:
            rows.append(TableRow(spec, None, None))
            continue
        cfg = compose([*overrides, *row_overrides(spec)], "evaluate")
        if spec.get("panel", PANELS[cfg.data.skeleton]) == PANELS[cfg.data.skeleton]:
            rows.append(TableRow(spec, cfg, describe(cfg)))
    return rows


def row_overrides(spec: dict[str, Any]) -> list[str]:
    """Return the overrides that make a row of the defaults."""
    method = [f"method={spec['method']}"] if "method" in spec else []
    return [f"source={spec['source']}", *method, *spec.get("overrides", [])]


def trained_by(row: TableRow) -> list[str]:
    """Return the row's own overrides that training knows: all that is not about scoring or sampling."""
    scoring = [*OmegaConf.load(CONF / "evaluate.yaml").keys(), "sampling"]
    own = [o for o in row.spec.get("overrides", []) if not o.startswith("generator.sampling.")]
    return [o for o in own if o.split("=")[0].split(".")[0] not in scoring]


def render_table(table: dict[str, Any], rows: list[TableRow], out: Path, command: str) -> list[Path]:
    """Write table.md, table.csv, table.tex and index.html; an incomplete row's cells stay empty."""
    from kinema.report.motions import read_samples
    from kinema.report.site import render

    some = next(row.cfg for row in rows if row.cfg is not None)
    panel = PANELS[some.data.skeleton]
    published = table["paper"].get(panel, {})
    results = with_borrowed(rows, {row.spec["key"]: _results(row) for row in rows})
    lines = rows
    rows = [row for row in rows if row.spec.get("shown", True)]
    filled = {**table, "rows": [_filled(row, published, results[row.spec["key"]]) for row in rows]}
    filled.pop("paper")
    beside = {"Beside the paper's metrics": filled.pop("beside", []), "Benchmark": benchmark_columns()}
    filled["panel"] = panel if published else None
    filled["comparable"] = some.data.paper == panel and some.scale.name == "paper"
    filled["corpus"] = some.data.name
    filled["scale"] = some.scale.name
    filled["provenance"] = provenance(lines, command)
    sections = [_section(title, columns, filled["rows"]) for title, columns in beside.items()]
    filled["breakdowns"] = [*sections, *_breakdowns(rows, results)]
    motions = {
        row.spec["key"]: read_samples(row.place.folder.path / "samples.npz")
        for row in rows
        if row.place is not None and results[row.spec["key"]] and "metrics" not in row.spec
    }
    return render(filled, out, {k: v for k, v in motions.items() if v})


def with_borrowed(rows: list[TableRow], results: Results) -> Results:
    """Give rows the metrics that they borrow from another row, replication by replication.

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
            found[key] = [{**line, **more} for line, more in zip(own, taken, strict=True)]
    return found


def provenance(rows: list[TableRow], command: str) -> dict[str, Any]:
    """Collect what the results of all rows say of themselves; where rows differ, row by row."""
    complete = [row for row in rows if row.complete]
    lines = [line["provenance"] for row in complete for line in row.lines]
    if not lines:
        return {"command": command}
    said = {row.spec["label"]: row.lines[0]["provenance"] for row in complete}
    found = {
        key: _agreed({label: facts[key] for label, facts in said.items()})
        for key in ("corpus", "statistics", "words", "tokens", "protocol", "device")
    }
    found["evaluators"] = _agreed({label: _evaluators(facts) for label, facts in said.items()})
    found["text encoder"] = sorted({line["text_encoder"] for line in lines if line["text_encoder"]})
    found["sampling"] = {label: facts["sampling"] for label, facts in said.items() if facts["sampling"]}
    found["seeds"] = sorted({line["seed"] for line in lines})
    found["versions"] = sorted({", ".join(f"{k} {v}" for k, v in sorted(line["versions"].items())) for line in lines})
    return {**found, "command": command}


def _evaluators(facts: dict[str, Any]) -> dict[str, str]:
    return {name: f"{facts['runs'][name]}, weights {weights}" for name, weights in facts["evaluators"].items()}


def _agreed(values: dict[str, Any]) -> Any:
    """Return the value of all rows, or where they differ each value under the labels of its rows."""
    groups: list[tuple[Any, list[str]]] = []
    for label, value in values.items():
        group = next((labels for other, labels in groups if other == value), None)
        if group is None:
            groups.append((value, [label]))
        else:
            group.append(label)
    return groups[0][0] if len(groups) == 1 else {"; ".join(labels): value for value, labels in groups}


def _results(row: TableRow) -> list[dict[str, Any]] | None:
    """Return the metrics by replication: an empty list where one is missing, None where the method isn't in Kinema."""
    if row.place is None:
        return None
    if not row.complete:
        return []
    renamed = row.spec.get("metrics")
    metrics = [line["metrics"] for line in row.lines]
    return [{key: m[name] for key, name in renamed.items()} for m in metrics] if renamed else metrics


def _filled(row: TableRow, published: dict[str, Any], results: list[dict[str, Any]] | None) -> dict[str, Any]:
    spec = row.spec
    return {
        "key": spec["key"],
        "label": spec["label"],
        "kind": spec["kind"],
        "note": "; ".join(note for note in (spec.get("note", ""), *_notes(row)) if note),
        "cannot": spec.get("cannot"),
        "published": published.get(spec["key"]),
        "results": results,
    }


def _notes(row: TableRow) -> tuple[str, ...]:
    """Say what of the row's making a reader can't see in its label."""
    lifted = row.cfg is not None and row.cfg.lift
    return _lengths_note(row), _steps_note(row), "redundant dims recomputed from the joints" if lifted else ""


def _lengths_note(row: TableRow) -> str:
    """Say where the lengths of generated motion come from, unless they are the test clips'."""
    if row.cfg is None or row.cfg.source != "generation" or row.cfg.task != "generation":
        return ""
    if row.cfg.lengths == "real":
        return "lengths of the test clips"
    return "lengths predicted by " + ("the method" if row.cfg.generator.get("predicts_length") else "an estimator")


def _steps_note(row: TableRow) -> str:
    """Say so where a diffusion model takes fewer steps than it was trained with."""
    if row.cfg is None or row.cfg.source != "generation":
        return ""
    trained = OmegaConf.select(row.cfg, "generator.model.process.steps")
    taken = OmegaConf.select(row.cfg, "generator.sampling.solver_steps")
    if trained is None or taken in (None, trained):
        return ""
    chosen = taken if isinstance(taken, int) else f"the steps {taken!r}"
    return f"sampled in {chosen} of its {trained} diffusion steps"


def _section(title: str, columns: list[dict[str, Any]], rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the rows that have something to show in these columns."""
    keys = {column["key"] for column in columns}
    shown = [{**row, "published": None} for row in rows if any(keys & line.keys() for line in row["results"] or ())]
    return {"title": title, "columns": columns, "rows": shown}


BREAKDOWN_COLUMNS = [
    {"key": "n", "label": "clips", "better": "none", "digits": 0},
    {"key": "r1", "label": "R@1", "better": "higher", "digits": 3},
    {"key": "r3", "label": "R@3", "better": "higher", "digits": 3},
    {"key": "matching", "label": "Matching", "better": "lower", "digits": 3},
]


def _breakdowns(rows: list[TableRow], results: Results) -> list[dict[str, Any]]:
    """Return one table per manifest field: every row's metrics by the field's values."""
    fields: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        if not results[row.spec["key"]] or "metrics" in row.spec:
            continue
        lines = row.lines
        for name in sorted(lines[0]["breakdowns"]):
            for value in sorted({v for line in lines for v in line["breakdowns"][name]}):
                cells = [line["breakdowns"][name][value] for line in lines if value in line["breakdowns"][name]]
                label = f"{row.spec['label']}: {value}"
                entry = {"key": f"{row.spec['key']}-{value}", "label": label, "kind": row.spec["kind"], "note": ""}
                fields.setdefault(name, []).append({**entry, "published": None, "results": cells})
    return [
        {"title": f"By {name}", "columns": BREAKDOWN_COLUMNS, "rows": found} for name, found in sorted(fields.items())
    ]
