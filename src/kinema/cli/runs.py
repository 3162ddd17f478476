"""Do what `kinema runs` and `kinema compare` are asked: list runs, and say how some of them differ."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from kinema.experiments.listing import DAMAGED, Listed, at, differences, find, judged, root_of
from kinema.runs.console import printable
from kinema.runs.folder import RunFolder
from kinema.runs.latest import find_run
from kinema.runs.parts import GENERATOR

MOST = 4
"""Differences that a line of the list has room for."""
SHOWN = ("val_loss", "r1", "r3", "fid", "clip_score")
"""Scores that a line of the list has room for."""


def runs(options: argparse.Namespace) -> None:
    """List runs: state, step, corpus, scale, scores, and in what each differs from those of its name."""
    root = root_of(options.root)
    found = find(root, options.words)
    if not found:
        of = f" whose stage, name or state hold {' '.join(options.words)}" if options.words else ""
        raise FileNotFoundError(f"{root.absolute()} holds no runs{of}")
    by_run = judged(root) if any(one.kind == GENERATOR for one in found) else {}
    rows = [("state", "step", "run", "corpus", "scale", "scores", "differs in")]
    whole = [one for one in found if one.damage is None]
    for one in found:
        if one.damage is not None:
            rows.append((DAMAGED, "", one.name, "", "", "", one.damage))
            continue
        corpus, scale = (str(at(one.config, key) or "") for key in ("data.name", "scale.name"))
        scores = _scores(by_run.get(one.folder.path.name, one) if one.kind == GENERATOR else one)
        rows.append((one.state, one.progress, one.name, corpus, scale, scores, _own(one, whole)))
    print(printable(aligned(rows)))


def compare(options: argparse.Namespace) -> None:
    """Say in what runs differ: settings, progress and scores."""
    found = [Listed(RunFolder(find_run(run))) for run in options.runs]
    for one in found:
        if not (one.folder.path / "status.json").is_file():
            raise FileNotFoundError(f"{one.folder.path} is no run folder: no status.json (`kinema runs` lists them)")
    unlike = differences(found)
    rows = [("", *(chr(ord("A") + i) for i in range(len(found))))]
    rows += [(key, *(_short(own[key], 40) for own in unlike)) for key in unlike[0]]
    status = [one.folder.status for one in found]
    rows += [("state", *(one.state for one in found)), ("step", *(one.progress for one in found))]
    rows += [(key, *(str(of.get(key, "")) for of in status)) for key in ("seconds", "parameters", "device")]
    scores = [one.scores() for one in found]
    for name in dict.fromkeys(name for own in scores for name in own):
        rows.append((name, *(own[name].text(3) if name in own else "" for own in scores)))
    for letter, one in zip(rows[0][1:], found, strict=True):
        print(f"{letter} = {one.folder.path}")
    print(printable(aligned([row for row in rows if any(row[1:])])))


def _scores(one: Listed) -> str:
    scores = one.scores()
    return ", ".join(f"{name} {scores[name].text(3)}" for name in SHOWN if name in scores)


def _own(one: Listed, found: Sequence[Listed]) -> str:
    """Say what tells a run from those that its name doesn't tell it from, beside seed and fingerprint."""
    alike = [other for other in found if _family(other) == _family(one)]
    own = differences(alike)[alike.index(one)]
    short = {key.removeprefix(f"{one.node}."): value for key, value in own.items() if value is not None}
    words = [f"{key}={_short(value, 24)}" for key, value in short.items()]
    return " ".join(words[:MOST]) + (f" and {len(words) - MOST} more" if len(words) > MOST else "")


def _family(one: Listed) -> str:
    return one.name.rsplit("-", 2)[0]


def _short(value: object, most: int) -> str:
    text = "" if value is None else " ".join(str(value).split())
    return text if len(text) <= most else f"{text[: most - 3]}..."


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Write rows with their columns under each other."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
