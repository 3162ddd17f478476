"""Tell how near the test clips are to training: of takes that it has, with frames and words that it has."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from kinema.data.doctor.finding import Finding
from kinema.data.doctor.patient import Patient
from kinema.data.leakage import HALF, frames_seen, takes_seen
from kinema.data.origin import Origin, tabulate


def takes(
    names: Sequence[str], splits: Sequence[str], mirrored: Sequence[bool], origins: Sequence[Origin | None]
) -> Iterator[Finding]:
    """Count the unmirrored test clips whose takes and frames training has, where the corpus tells the takes."""
    rows, _ = tabulate(origins)
    where = np.array(splits, dtype=str)
    asked = np.flatnonzero((where == "test") & ~np.array(mirrored, dtype=bool))
    known = asked[rows["take"][asked] >= 0]
    if not len(known):
        return
    trained = rows[where == "train"]
    seen, shares = takes_seen(rows[known], trained), frames_seen(rows[known], trained)
    unknown = f" ({len(asked) - len(known)} more are of unknown takes)" if len(asked) > len(known) else ""
    message = (
        f"of {len(known)} unmirrored test clips{unknown} {_part(seen)} are of a take that training has, "
        f"{_part(shares > 0)} share frames with a training clip, {_part(shares >= HALF)} at least half of theirs"
    )
    items = tuple(f"{names[known[i]]} ({shares[i]:.0%})" for i in np.argsort(-shares, kind="stable") if shares[i] > 0)
    fix = "read results without them too: tables have them in parts" if items else ""
    yield Finding("info", "nearness", message, fix, items)


def words(patient: Patient) -> Iterator[Finding]:
    """Count the captions of unmirrored test clips that training has word for word."""
    clips = list(zip(patient.splits, patient.mirrored, patient.captions, strict=True))
    trained = {c.text for split, _, captions in clips if split == "train" for c in captions}
    asked = [c.text for split, mirrored, captions in clips if split == "test" and not mirrored for c in captions]
    if asked:
        seen = np.array([text in trained for text in asked])
        message = f"of {len(asked)} captions of unmirrored test clips {_part(seen)} occur verbatim in training"
        yield Finding("info", "nearness", message)


def _part(chosen: np.ndarray) -> str:
    return f"{chosen.sum()} ({chosen.mean():.1%})"
