"""Find clips that are nearly the same motion, and recordings that were cut into more than one split."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from kinema.data.doctor.finding import Finding, Severity
from kinema.data.doctor.patient import Patient
from kinema.data.origin import SOURCE_FIELDS

WIDTH = 128
"""Width of the random projection in which neighbours are looked for."""
CANDIDATES = 8
"""Neighbours in the projection whose distance is then measured exactly."""
SAME, CLOSE, NEAR = 0.001, 0.01, 0.02
"""Mean joint distances in metres: the same motion, a near-duplicate, a similar take."""
CLOSE_SHARE = 0.01
"""Share of val/test clips that may have a near-duplicate in training before it is worth a warning."""
BLOCK = 1024


def nearest(
    queries: Float[np.ndarray, "n k"], base: Float[np.ndarray, "m k"], itself: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Find each query's nearest clip of the base: its index and the mean joint distance (metres).

    Neighbours come from a random projection, distances are exact. `itself`: queries are the base, and no clip is
    its own neighbour.
    """
    rng = np.random.default_rng(0)
    project = rng.normal(size=(base.shape[1], WIDTH)).astype(np.float32) / np.sqrt(WIDTH)
    small, projected = base @ project, queries @ project
    size = np.square(small).sum(1)
    count = min(CANDIDATES, len(base) - itself)
    index, distance = np.zeros(len(queries), dtype=int), np.full(len(queries), np.inf)
    if count < 1:
        return index, distance
    for start in range(0, len(queries), BLOCK):
        rows = np.arange(start, min(start + BLOCK, len(queries)))
        score = size - 2 * projected[rows] @ small.T
        if itself:
            score[np.arange(len(rows)), rows] = np.inf
        found = np.argpartition(score, count - 1, axis=1)[:, :count]
        gap = (base[found] - queries[rows, None]).reshape(*found.shape, -1, 3)
        exact = np.linalg.norm(gap, axis=-1).mean(-1)
        best = exact.argmin(1)
        index[rows], distance[rows] = found[np.arange(len(rows)), best], exact[np.arange(len(rows)), best]
    return index, distance


def near_duplicates(patient: Patient, poses: Float[np.ndarray, "n k"]) -> Iterator[Finding]:
    """Compare val and test clips with all training clips, and clips of one split with each other."""
    splits, originals = np.array(patient.splits), ~np.array(patient.mirrored, dtype=bool)
    base, tested = np.flatnonzero(splits == "train"), np.flatnonzero((splits != "train") & originals)
    if len(base) and len(tested):
        found, distance = nearest(poses[tested], poses[base])
        yield _across(patient, tested, base[found], distance)
    for split in dict.fromkeys(patient.splits):
        chosen = np.flatnonzero((splits == split) & originals)
        found, distance = nearest(poses[chosen], poses[chosen], itself=True)
        twins = [i for i in np.flatnonzero(distance < SAME) if i < found[i] or distance[found[i]] >= SAME]
        if twins:
            items = tuple(_pair(patient, chosen[i], chosen[found[i]], distance[i]) for i in twins)
            message = f"{len(twins)} pairs of clips in {split} are the same motion (within {SAME * 1000:g} mm)"
            yield Finding("warning", "duplicates", message, "keep one of each pair, with the captions of both", items)


def _across(patient: Patient, tested: np.ndarray, train: np.ndarray, distance: np.ndarray) -> Finding:
    order = np.argsort(distance, kind="stable")
    same, close, near = ((distance < limit).sum() for limit in (SAME, CLOSE, NEAR))
    message = (
        f"of {len(tested)} val/test clips {close} lie within 1 cm of a training clip (mean joint distance), {near} "
        f"within 2 cm; median {np.median(distance) * 100:.1f} cm"
    )
    items = tuple(_pair(patient, tested[i], train[i], distance[i]) for i in order if distance[i] < CLOSE)
    if same:
        fix = "put both into one split, or drop one: the test would measure memory"
        return Finding("error", "near-duplicates", f"{message}; {same} are the same motion", fix, items)
    if close > CLOSE_SHARE * len(tested):
        fix = "take neighbouring takes into one split, or report results without these clips too"
        return Finding("warning", "near-duplicates", message, fix, items)
    return Finding("info", "near-duplicates", message, items=items)


def leakage(patient: Patient) -> Iterator[Finding]:
    """Find recordings whose parts, or whose mirror image, are in more than one split."""
    groups: list[tuple[Severity, str, list[str]]] = [
        (
            "error",
            "clip",
            [base_name(name, mirrored) for name, mirrored in zip(patient.names, patient.mirrored, strict=True)],
        ),
        ("warning", "recording", [_recording(patient, i) for i in range(len(patient))]),
    ]
    for severity, what, keys in groups:
        where: dict[str, set[str]] = defaultdict(set)
        for key, split in zip(keys, patient.splits, strict=True):
            if key:
                where[key].add(split)
        shared = tuple(f"{key} ({', '.join(sorted(s))})" for key, s in where.items() if len(s) > 1)
        if shared:
            yield Finding(
                severity,
                "leakage",
                f"{len(shared)} of {len(where)} source {what}s have parts or mirror images in more than one split",
                "split by source, and put M* beside its original; say so with results if the split is published",
                shared,
            )


def base_name(name: str, mirrored: bool) -> str:
    """Name the clip that a clip was cut from (`_s0`) or is the mirror image of (`M`)."""
    return re.sub(r"_s\d+$", "", name[1:] if mirrored else name)


def _recording(patient: Patient, clip: int) -> str:
    """Name the recording that a clip was cut from where the corpus says more of it than the clip's name does."""
    known, origin = patient.known[clip], patient.origins[clip]
    if origin is not None:
        return "" if origin.take == base_name(patient.names[clip], patient.mirrored[clip]) else origin.take
    return next((known[f] for f in SOURCE_FIELDS if known.get(f)), "")


def _pair(patient: Patient, one: int, other: int, distance: float) -> str:
    return f"{patient.names[one]} ~ {patient.names[other]} ({distance * 100:.2g} cm)"
