"""Say what the results of a table rest on: what all rows share once, what they don't row by row."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

SHARED = ("corpus", "statistics", "words", "tokens", "protocol", "device")
Facts = dict[str, Any]


@dataclass(frozen=True)
class Said:
    """Hold the results of a complete row, a line for each replication; its training seeds share a `label`."""

    label: str
    own_label: str
    lines: Sequence[dict[str, Any]]

    @property
    def facts(self) -> Iterator[tuple[int, Facts]]:
        """Give the replications and what each says of itself."""
        return ((line["replication"], line["provenance"]) for line in self.lines)


def provenance(rows: Sequence[Said], command: str) -> dict[str, Any]:
    """Collect what the results of complete rows say of themselves."""
    everything = [facts for row in rows for _, facts in row.facts]
    if not everything:
        return {"command": command}
    found = {key: _agreed(rows, itemgetter(key)) for key in SHARED}
    found["evaluators"] = _agreed(rows, _evaluators)
    found["text encoder"] = sorted({facts["text_encoder"] for facts in everything if facts["text_encoder"]})
    firsts = [(row, next(row.facts)[1]) for row in rows]
    found["sampling"] = {row.label: facts["sampling"] for row, facts in firsts if facts["sampling"]}
    found["seeds"] = sorted({facts["seed"] for facts in everything})
    versions = (facts["versions"] for facts in everything)
    found["versions"] = sorted({", ".join(f"{k} {v}" for k, v in sorted(named.items())) for named in versions})
    return {**found, "command": command}


def other_judges(rows: Sequence[Said]) -> list[str]:
    """Say which rows were scored by evaluators that were trained anew meanwhile: of the same recipe, but others."""
    weights: dict[str, set[str]] = {}
    for row in rows:
        for _, facts in row.facts:
            for name, digest in facts["evaluators"].items():
                weights.setdefault(facts["runs"][name], set()).add(digest)
    anew = sorted(run for run, digests in weights.items() if len(digests) > 1)
    if not anew:
        return []
    return [
        f"The rows are scored by evaluators of different weights ({', '.join(anew)}: Provenance says which rows by "
        "which): their FIDs can't be compared; delete the rows of the older ones to have them scored anew."
    ]


def _evaluators(facts: Facts) -> dict[str, str]:
    return {name: f"{facts['runs'][name]}, weights {weights}" for name, weights in facts["evaluators"].items()}


def _agreed(rows: Sequence[Said], of: Callable[[Facts], Any]) -> Any:
    """Return the value of all rows, or where they differ each value under the labels of what has it."""
    labels: dict[str, list[tuple[str, Any]]] = {}
    for row in rows:
        labels.setdefault(row.label, []).extend(_by_replication(row, of))
    groups: list[tuple[Any, list[str]]] = []
    for label, values in labels.items():
        alike = all(value == values[0][1] for _, value in values)
        for name, value in [(label, values[0][1])] if alike else values:
            group = next((names for other, names in groups if other == value), None)
            if group is None:
                groups.append((value, [name]))
            else:
                group.append(name)
    return groups[0][0] if len(groups) == 1 else {"; ".join(names): value for value, names in groups}


def _by_replication(row: Said, of: Callable[[Facts], Any]) -> list[tuple[str, Any]]:
    """Return a row's value, or where its replications differ that of each."""
    values = [(replication, of(facts)) for replication, facts in row.facts]
    if all(value == values[0][1] for _, value in values):
        return [(row.own_label, values[0][1])]
    return [(f"{row.own_label}, replication {replication}", value) for replication, value in values]
