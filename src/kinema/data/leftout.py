"""Say what a corpus was left without, and refuse one that lost too much."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from kinema.data.catalog import SPLITS, Catalog, Dropped
from kinema.data.slips import READABLE
from kinema.motion.skeleton import get_skeleton

MAX_UNUSABLE = 0.2
"""Share of a corpus' clips that may be unusable: above it the corpus is another than it was taken for."""
SHOWN = 5
"""Clips that are written out."""


def check_share(name: str, dropped: Sequence[Dropped], clips: int, most: float) -> None:
    """Raise ValueError if more than the share `most` of a corpus' clips is unusable, with every reason and fix."""
    unusable = [d for d in dropped if d.what == "clip"]
    if len(unusable) <= most * clips or len(unusable) == clips == 0:
        return
    told = []
    for same in by_problem(unusable):
        fix = f"; fix: {same[0].fix}" if same[0].fix else ""
        told.append(f"{len(same)} clips (first, {same[0].name!r}: {same[0].reason}{fix})")
    none = "has no usable clip: " if len(unusable) == clips else ""
    raise ValueError(
        f"corpus {name!r} {none}{len(unusable)} of {clips} clips are unusable, more than the allowed share {most:g}: "
        f"{', '.join(told)}; mend them, unlist them or allow more (kinema prepare --set max_unusable=SHARE, "
        "or +data.options.max_unusable=SHARE)"
    )


def by_problem(dropped: Sequence[Dropped]) -> list[list[Dropped]]:
    """Group what was left out by what it takes to mend it: the kind of problem and its fix, the most frequent first."""
    found = defaultdict(list)
    for one in dropped:
        found[one.kind, one.fix].append(one)
    return sorted(found.values(), key=len, reverse=True)


def told_of(catalog: Catalog, dropped: Sequence[Dropped], manifest: dict[str, Any], out: Path) -> Iterator[str]:
    """Write for people how a corpus was read and what it was left without; nothing where there is nothing to say."""
    if catalog.rate:
        yield f"rate      {catalog.rate}; entries have {get_skeleton(manifest['skeleton']).fps:g} fps"
    for flaw in READABLE:
        if slips := [str(slip) for slip in catalog.slips if slip.flaw is flaw]:
            shown = f"{'; '.join(slips[:SHOWN])}{'; ...' if len(slips) > SHOWN else ''}"
            yield f"{flaw.of:<10}{len(slips)} {flaw.message}: {shown}; fix: {flaw.fix}"
    units = {"missing": "listed clips without files", "clip": "unusable clips", "caption": "unreadable captions"}
    for what, unit in units.items():
        for found in by_problem([d for d in dropped if d.what == what]):
            shown = "; ".join(f"{d.name} ({' '.join(d.reason.split())})" for d in found[:SHOWN])
            fix = f"; fix: {found[0].fix}" if found[0].fix else ""
            yield f"left out  {len(found)} {unit}: {shown}{'; ...' if len(found) > SHOWN else ''}{fix}"
    if filtered := [d for d in dropped if d.what == "entry"]:
        first = f"{filtered[0].name}: {filtered[0].reason}"
        yield f"left out  {len(filtered)} entries outside the length filter (first, {first})"
    counts = {split: manifest["splits"][split] for split in SPLITS}
    entries = {split: n["entries"] + n["entries_without_captions"] for split, n in counts.items()}
    if empty := [split for split, n in entries.items() if not n]:
        yield f"warning   no entry is left in {', '.join(empty)}: `kinema doctor {out}` says why"
    if dropped:
        yield f"          {sum(entries.values())} entries are left; all that was left out is in {out / 'dropped.json'}"
