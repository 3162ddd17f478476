"""Say in words what a report's reader must know: whose corpus, what is missing, where the numbers come from."""

from __future__ import annotations

from typing import Any

from kinema.report.cells import FLAG, Grid
from kinema.report.intervals import explain

EFFECTS = "Effects, here and in the paper"
PAPER_CORPORA = {"humanml3d": "HumanML3D", "kit_ml": "KIT-ML"}


def notice(table: dict[str, Any]) -> str:
    """Say which corpus the numbers are of, and whether the published ones may be held against them.

    `panel` is the corpus whose published numbers the table shows.
    """
    corpus = str(table.get("corpus") or "not recorded")
    scale = table.get("scale")
    paper = PAPER_CORPORA.get(str(table.get("panel")))
    here = f"Corpus: {PAPER_CORPORA.get(corpus, corpus)}" + (f"; scale: {scale}" if scale else "")
    if paper is None:
        return f"{here}. The paper has no numbers of such motion."
    if table.get("comparable"):
        return f"{here}. The paper's numbers are of the same corpus."
    if corpus in PAPER_CORPORA:
        return f"{here}. The paper's numbers are {paper} results of full-size training and are not comparable."
    return f"{here}. The paper's numbers are {paper} results and are not comparable."


def legend(main: Grid) -> str:
    """Say what the numbers of a table are."""
    how = explain(main.intervals, [line.replications for line in main.lines])
    text = f"Mean ± 95 % interval over n replications ({how}; one replication has none)."
    if any(line.seeds for line in main.lines):
        text += " n seeds: over models of that many training seeds, each the mean of its replications."
    if any(cell.ours is None for line in main.lines if line.replications for cell in line.cells):
        text += " –: not applicable to the row, or scored before the metric was there."
    return f"{text} Bold: the best method, if its interval overlaps no other method's." if main.marked else text


def flags_legend(content: Grid) -> str:
    """Say what the marks of a table mean; nothing if no cell has one."""
    columns = enumerate(content.columns)
    flags = dict.fromkeys(c.flag for i, c in columns if c.flag and any(line.cells[i].flagged for line in content.lines))
    return " ".join(f"{FLAG} above {flag.above:g}: {flag.means}." for flag in flags)


def effects_legend(main: Grid) -> str:
    """Say what the differences of a table are."""
    how = explain(main.intervals, [line.replications for line in main.lines])
    if any(line.seeds for line in main.lines):
        return (
            f"First row minus second, training seed by training seed, and its 95 % interval over them ({how}); in "
            "brackets over replications, each the mean of these seeds: what the evaluation's draws change."
        )
    return (
        f"First row minus second, replication by replication, and its 95 % interval ({how}): over the evaluation's own "
        "draws, not over training seeds."
    )


def unfinished(main: Grid) -> list[str]:
    """Name the rows that have no results, those without an implementation apart."""
    idle = [line for line in main.lines if not line.replications]
    groups = {
        "Not yet run": [line.label for line in idle if line.implemented],
        "Not in Kinema yet": [line.label for line in idle if not line.implemented and line.possible],
    }
    return [f"{what}: {', '.join(names)}." for what, names in groups.items() if names]


def notes_by_text(main: Grid) -> list[str]:
    """Return the rows' notes, rows of one note together."""
    notes: dict[str, list[str]] = {}
    for line in main.lines:
        if line.note:
            notes.setdefault(line.note, []).append(line.label)
    return [f"{', '.join(labels)}: {note}" for note, labels in notes.items()]


def flatten(facts: Any, prefix: str = "") -> list[tuple[str, str]]:
    """Return nested facts as sorted lines of (dotted key, text)."""
    if isinstance(facts, dict):
        return [line for key in sorted(facts, key=str) for line in flatten(facts[key], f"{prefix}.{key}".lstrip("."))]
    text = "; ".join(map(str, facts)) if isinstance(facts, list | tuple) else str(facts)
    return [(prefix, text)]
