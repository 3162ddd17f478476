"""Check what a corpus holds: counts, what is missing, captions, sides, statistics, jumps, units."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator

import numpy as np

from kinema.data.captions import swap_sides
from kinema.data.catalog import SPLITS, Dropped
from kinema.data.doctor.finding import Finding, Severity
from kinema.data.doctor.patient import Patient
from kinema.data.doctor.sketch import Sketch
from kinema.data.leftout import by_problem
from kinema.data.slips import READABLE, UNREADABLE
from kinema.motion.checks import MAX_SPEED
from kinema.motion.geometry import likely_rate
from kinema.motion.statistics import PUBLISHED_DIVISOR, Statistics
from kinema.types import Caption

MANY_MISSING = 0.05
"""Share of listed clips without files above which a corpus is another one than it is taken for."""
MISREAD = ("shape", "order", "axis", "sides", "unit")
"""Kinds of problem that say how the whole corpus was misread, if many clips have them."""
FEW = 0.01
"""Share up to which slips in captions are but a warning."""
_SIDE = re.compile(r"\b(left|right|(?:counter)?clockwise)")
_AGAINST = re.compile(r"\b(?:counter|anti)[ -]?(?=clockwise)")


def counts(patient: Patient) -> Iterator[Finding]:
    """Count clips, frames and captions per split; an empty split is wrong."""
    lines, empty = [], []
    for split in SPLITS:
        chosen = [i for i, s in enumerate(patient.splits) if s == split]
        captions = sum(len(patient.captions[i]) for i in chosen)
        mirrored = sum(patient.mirrored[i] for i in chosen)
        lines.append(f"{split} {len(chosen)} clips ({mirrored} mirrored), {captions} captions")
        if not any(patient.entries[i] for i in chosen):
            empty.append(split)
    if empty:
        yield _empty_splits(patient, empty)
    yield Finding("info", "counts", f"{patient.name} ({patient.skeleton.name}): {'; '.join(lines)}")
    repeated = tuple(name for name, n in Counter(patient.names).items() if n > 1)
    if repeated:
        yield Finding("error", "duplicate names", f"{len(repeated)} names are used twice", "rename them", repeated)


def _empty_splits(patient: Patient, empty: list[str]) -> Finding:
    """Tell why splits have no entry: nothing listed, nothing usable, or nothing of a usable length."""
    which = ", ".join(empty)
    lost = [d for d in patient.dropped if d.split in empty and d.what in ("missing", "clip", "entry")]
    if not lost:
        return Finding("error", "empty split", f"{which} list no clip", f"list clips in {empty[0]}.txt")
    if not any(d.what == "entry" for d in lost):
        fix = "mend the clips as said of them, or list others"
        return Finding("error", "empty split", f"{which} have no usable clip", fix, tuple(map(_item, lost)))
    limits = f"{patient.skeleton.min_frames} <= frames < {patient.skeleton.max_frames} at {patient.skeleton.fps:g} fps"
    fix = (
        "if the clips have another rate, say it (--fps 60, data.fps=60); cut longer ones into pieces (NAME_s0, NAME_s1)"
    )
    return Finding("error", "empty split", f"{which} have no entry of {limits}", fix, tuple(map(_item, lost)))


def left_out(patient: Patient) -> Iterator[Finding]:
    """Tell what was not used, by reason."""
    lost = {what: [d for d in patient.dropped if d.what == what] for what in ("missing", "clip", "caption", "entry")}
    told = {
        "missing": ("missing files", "are listed but lack files", "complete the download, or take them off the lists"),
        "caption": (UNREADABLE.name, UNREADABLE.message, UNREADABLE.fix),
    }
    for what, (kind, message, fix) in told.items():
        if found := lost[what]:
            share = len(found) / (len(found) + len(patient))
            severity: Severity = "error" if what == "missing" and share > MANY_MISSING else "warning"
            yield Finding(severity, kind, f"{len(found)} {message}", fix, tuple(map(_item, found)))
    yield from _unusable(lost["clip"], len(patient))
    if found := lost["entry"]:
        limits = f"{patient.skeleton.min_frames} <= frames < {patient.skeleton.max_frames}"
        names = tuple(d.name for d in found)
        yield Finding("info", "length filter", f"{len(found)} entries are outside {limits}", items=names)


def _unusable(dropped: list[Dropped], usable: int) -> Iterator[Finding]:
    """Tell which clips hold no motion, one finding a problem; a kind that one clip in twenty has is but a warning."""
    total, kinds = len(dropped) + usable, Counter(d.kind for d in dropped)
    for found in by_problem(dropped):
        kind, items = found[0].kind, tuple(map(_item, found))
        severity: Severity = "error" if kinds[kind] > MANY_MISSING * total else "warning"
        if kind in MISREAD:
            first = "" if len({d.reason for d in found}) == 1 else f"first, {found[0].name}: "
            message = f"{len(found)} of {total} clips: {first}{found[0].reason}"
            yield Finding(severity, kind, message, found[0].fix, tuple(d.name for d in found))
        else:
            fix = "extract these clips again, or take them off the lists"
            message = f"{len(found)} hold no motion that can be used, or cannot be read"
            yield Finding("warning" if kind else severity, "unusable clips", message, fix, items)


def _item(dropped: Dropped) -> str:
    return f"{dropped.name} ({dropped.reason})"


def captions(patient: Patient) -> Iterator[Finding]:
    """Find clips without captions, captions without tokens, and tokens that tell another side than the text."""
    bare = tuple(patient.names[i] for i in range(len(patient)) if not patient.captions[i])
    untagged = {d.name for d in patient.dropped if d.what == "entry"}
    bare = tuple(name for name in bare if name not in untagged)
    if bare:
        yield Finding(
            "warning",
            "no captions",
            f"{len(bare)} clips have no caption: only tokenizers are trained on them",
            "add texts/NAME.txt, one caption a line",
            bare,
        )
    for flaw in READABLE:
        if slips := tuple(str(slip) for slip in patient.slips if slip.flaw is flaw):
            yield Finding(flaw.severity, flaw.name, f"{len(slips)} {flaw.message}", flaw.fix, slips)
    every = [(patient.names[i], c) for i in range(len(patient)) for c in patient.captions[i]]
    plain = tuple(name for name, c in every if not c.tokens)
    if plain:
        yield Finding(
            "info",
            "no tokens",
            f"{len(plain)} of {len(every)} captions have no word/POS tokens; the T2M evaluator then tags them itself",
            "pip install 'kinema[tag]' for the tags of the published corpora",
            plain,
        )
    torn = tuple(f"{name} ({c.text!r})" for name, c in every if c.tokens and _sides(c.text) != _sides(_words(c)))
    if torn:
        yield Finding(
            _severity(len(torn), len(every)),
            "sides in tokens",
            f"{len(torn)} captions name other sides in their text than in their tokens",
            "swap left and right in both (kinema.data.captions.swap_sides), or in neither",
            torn,
        )


def sides(patient: Patient) -> Iterator[Finding]:
    """Check that the captions of a mirrored clip say left where its original says right."""
    place = {name: i for i, name in enumerate(patient.names)}
    same: list[str] = []
    odd: list[str] = []
    pairs = 0
    for name, i in place.items():
        original = place.get(name[1:]) if patient.mirrored[i] else None
        if original is None:
            continue
        told = [c.text for c in patient.captions[original]]
        expected = Counter(swap_sides(text) for text in told)
        found = Counter(c.text for c in patient.captions[i])
        pairs += 1
        if found != expected:
            (same if found == Counter(told) else odd).append(name)
    if same:
        yield Finding(
            _severity(len(same), pairs),
            "sides not swapped",
            f"{len(same)} of {pairs} mirrored clips have the captions of their original, sides included: these were "
            "never swapped, or swapped twice",
            "swap left and right, clockwise and counterclockwise in M*.txt exactly once; official ones come swapped",
            tuple(same),
        )
    if odd:
        yield Finding(
            "warning",
            "sides",
            f"{len(odd)} of {pairs} mirrored clips have captions that are not the swapped ones of their original",
            "write M*.txt with kinema.data.captions.swap_sides; a chain of str.replace swaps some words twice",
            tuple(odd),
        )


def statistics(patient: Patient) -> Iterator[Finding]:
    """Compare the mean and deviation that the corpus brought with those of its features."""
    own = patient.statistics
    if own is None or not len(patient):
        return
    skeleton = patient.skeleton
    computed = Statistics.compute((patient.rows(i) for i in range(len(patient))), skeleton)
    ratio = {name: own.std[cols] / computed.std[cols] for name, cols in skeleton.groups.items()}
    biased = [n for n, r in ratio.items() if n in ("root_yaw", "root_linear", "root_height", "contacts") and _near(r)]
    fix = "remove Mean.npy and Std.npy so that they are computed, then prepare again"
    if len(biased) == 4:
        yield Finding(
            "error",
            "statistics",
            f"the deviation of root and contacts is the real one divided by {PUBLISHED_DIVISOR:g}: the T2M family's "
            "variant, taken for the raw one",
            f"{fix}; models that want this variant ask for it (Representation(variant='published'))",
        )
        return
    uneven = [name for name, cols in skeleton.groups.items() if np.ptp(own.std[cols]) > 1e-3 * own.std[cols].mean()]
    if uneven:
        message = f"the deviation is not averaged over the columns of {', '.join(uneven)}, as published"
        yield Finding("error", "statistics", message, fix)
    deviation = float(np.abs((own.mean - computed.mean) / computed.std).max())
    off = [name for name, r in ratio.items() if abs(np.log(r.mean())) > 0.1]
    if deviation > 0.1 or (off and not uneven):
        detail = f"the mean is off by up to {deviation:.2f} deviations"
        detail += f", the deviation of {', '.join(off)} by more than 10 %" if off else ""
        yield Finding("error", "statistics", f"Mean and Std are not those of these clips: {detail}", fix)


def motion(patient: Patient, seen: Sketch) -> Iterator[Finding]:
    """Find jumps, what a wrong convention left in the joints, and a rate or a floor that cannot be."""
    jumps = np.flatnonzero(seen.speeds > MAX_SPEED)
    misread = {kind: [i for i, p in enumerate(seen.problems) if kind in p] for kind in MISREAD}
    if len(jumps) and not misread["unit"]:
        yield Finding(
            "warning",
            "jumps",
            f"{len(jumps)} clips have a joint faster than {MAX_SPEED:g} m/s",
            "cut the clips there, or repair the tracking",
            tuple(f"{patient.names[i]} ({seen.speeds[i]:.0f} m/s)" for i in jumps),
        )
    for kind, found in misread.items():
        if found:
            problem = seen.problems[found[0]][kind]
            severity: Severity = "error" if len(found) > MANY_MISSING * len(patient) else "warning"
            message = f"{len(found)} of {len(patient)} clips: {problem.message}"
            fix = f"prepare again from joints with {problem.fix}"
            yield Finding(severity, kind, message, fix, tuple(patient.names[i] for i in found))
    low, high = (0.4, 1.4) if patient.skeleton.name == "humanml3d" else (250, 900)
    typical = float(np.median(seen.heights))
    if not low <= typical <= high and not any(misread.values()):
        message = f"the median root height is {typical:.3g} {patient.skeleton.unit}, a standing person's is between"
        yield Finding(
            "error", "height", f"{message} {low:g} and {high:g}", "put the clips on the floor (lowest joint at 0)"
        )
    yield from _rate(patient, seen)


def _rate(patient: Patient, seen: Sketch) -> Iterator[Finding]:
    """Tell where a folder's rate is known from, and guess another where people don't move like that."""
    rate, untold = patient.skeleton.fps, np.array(patient.untold)
    some = not untold.all()
    names = tuple(name for name, guessed in zip(patient.names, untold, strict=True) if guessed and some)
    if patient.rate:
        yield Finding("info", "rate", f"frame rate: {patient.rate}; entries have {rate:g} fps", items=names)
    paces = seen.paces[untold]
    guess = likely_rate(float(np.nanmedian(paces)), rate) if np.isfinite(paces).any() else None
    if guess is not None:
        which = f"the {len(names)} clips without a rate" if some else "the clips"
        message = f"{which} move as if recorded at about {guess:g} fps and read at {rate:g} (guessed from their speed)"
        fix = f"--fps {guess:g} (data.fps={guess:g}) if so, --fps {rate:g} if not"
        if some:  # an option would come before what is told of the others
            fix = f'give them "fps": {guess:g} in manifest.json if so, {rate:g} if not'
        yield Finding("warning", "rate", message, fix, names)


def _severity(count: int, total: int) -> Severity:
    """Call it an error if it is more than a few slips."""
    return "error" if count > FEW * total else "warning"


def _sides(text: str) -> list[str]:
    """List the sides that a text names, in order."""
    return _SIDE.findall(_AGAINST.sub("counter", text.lower()))


def _words(caption: Caption) -> str:
    return " ".join(token.rpartition("/")[0] for token in caption.tokens)


def _near(ratio: np.ndarray) -> bool:
    return bool(np.all(np.abs(ratio * PUBLISHED_DIVISOR - 1) < 0.1))
