"""Do what the page asks of a model, within limits: generate, regenerate a part, write a file. No gradio in here."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

from annotated_types import Interval

from kinema.motion.export import save
from kinema.motion.skeleton import Skeleton
from kinema.options import check_value
from kinema.pipeline import TextToMotion
from kinema.types import Motion

LETTERS = 300
"""Letters of a text; encoders read less (77 tokens or fewer)."""
COUNT = 4
"""Motions of one request."""
SHOWN = 8
"""Motions that a visitor has at once; the oldest go first."""


@dataclass(frozen=True)
class Take:
    """Hold one motion of a visitor: its number, which stays, and what part of which other one it changed."""

    number: int
    motion: Motion
    note: str = ""

    @property
    def label(self) -> str:
        """Return what it is called: `2` or `3 (2 with 1.0 to 2.0 s new)`."""
        return f"{self.number} ({self.note})" if self.note else str(self.number)


class Studio:
    """Answer a visitor's requests with one model; raises ValueError, in one line, for what it can't or won't do."""

    def __init__(self, model: TextToMotion) -> None:
        self.model = model.eval()

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton of the motions, which says how many frames a second has."""
        return self.model.skeleton

    @property
    def longest(self) -> float:
        """The seconds of the longest motion."""
        return int(self.model.max_frames / self.skeleton.fps * 10) / 10

    @property
    def edits(self) -> bool:
        """Whether a stretch of time can be regenerated: not where one latent holds the whole motion (MLD)."""
        return self.model.generator.space.unit is not None

    @property
    def edits_parts(self) -> bool:
        """Whether a part of the body can: methods that generate frames."""
        return self.model.tokenizer.space.kind == "frames"

    def generate(
        self, takes: Sequence[Take], text: str, seconds: float | None, count: int, seed: int | None
    ) -> list[Take]:
        """Add `count` motions of a text; `seconds=None` leaves the length to the model."""
        check_value(count, Annotated[int, Interval(ge=1, le=COUNT)], "count")
        if seconds is not None:
            check_value(seconds, Annotated[float, Interval(gt=0, le=self.longest)], "seconds")
        made = self.model.generate([_short(text)] * count, seconds=seconds, seed=seed)
        return _with(takes, made)

    def regenerate(
        self, takes: Sequence[Take], number: int, text: str, frames: tuple[int, int], part: str | None, seed: int | None
    ) -> list[Take]:
        """Add a motion in which frames [start, end) of another, or of `part` of its body, follow another text."""
        source = self.find(takes, number).motion
        made = self.model.edit(source, _short(text), [frames], parts=part, seed=seed)
        start, end = (frame / source.fps for frame in frames)
        what = f"{part} body, " if part else ""
        return _with(takes, made, f"{number} with {what}{start:.1f} to {end:.1f} s new")

    def find(self, takes: Sequence[Take], number: int) -> Take:
        """Return a visitor's motion by its number."""
        for take in takes:
            if take.number == number:
                return take
        raise ValueError("there is no such motion any more: generate one first")

    def write(self, takes: Sequence[Take], number: int, suffix: str) -> tuple[str, bytes]:
        """Return a motion as the name and the bytes of a file; it stays on the disk only while it is written."""
        take = self.find(takes, number)
        words = "-".join(re.findall(r"[a-z0-9]+", take.motion.text.lower()))[:40].strip("-")
        with TemporaryDirectory() as folder:
            path = save(take.motion, Path(folder) / f"{words or 'motion'}-{number}{suffix}")
            return path.name, path.read_bytes()


def read_seed(text: str) -> int | None:
    """Read what stands in the field of a seed; None if nothing does."""
    if not text.strip():
        return None
    try:
        return int(text)
    except ValueError:
        raise ValueError(f"seed {text.strip()!r} is no whole number; leave it empty to draw one") from None


def _short(text: str) -> str:
    if len(text) > LETTERS:
        raise ValueError(f"the text has {len(text)} letters; at most {LETTERS} are read here, so shorten it")
    return text


def _with(takes: Sequence[Take], motions: Sequence[Motion], note: str = "") -> list[Take]:
    first = takes[-1].number + 1 if takes else 1
    return [*takes, *(Take(first + i, motion, note) for i, motion in enumerate(motions))][-SHOWN:]
