"""Draw what an action does and record it in words, so that captions say what the motion shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kinema.data.synthetic.tracks import Tracks, smooth

SHORTEST, LONGEST = 2.2, 9.8
"""Seconds of a clip: with one frame lost to extraction, 40 to 196 rows at 20 fps and 24 to 123 at 12.5."""

TIMES = {
    1: ("once", "one time", "a single time", ""),
    2: ("twice", "two times", "two times in a row"),
    3: ("three times", "three times in a row"),
    4: ("four times", "four times in a row"),
    5: ("five times", "five times in a row"),
}


@dataclass
class Plan:
    """Hold the draws of one performance: its generator, tempo and size, and the words for what was chosen.

    `closed` asks that it starts and ends standing, feet side by side, so that another one can follow or precede it.
    `words` maps each slot of the action's phrases to synonyms.
    """

    rng: np.random.Generator
    fps: float
    tempo: float = 1.0
    size: float = 1.0
    closed: bool = False
    longest: float = LONGEST
    words: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def choose(self, slot: str, options: Mapping[Any, tuple[str, ...]]) -> Any:
        """Pick one of the options and put its words into the slot."""
        keys = list(options)
        key = keys[self.rng.integers(len(keys))]
        self.words[slot] = options[key]
        return key

    def uniform(self, low: float, high: float) -> float:
        """Draw a number that captions don't mention."""
        return float(self.rng.uniform(low, high))

    def count(self, period: float, most: int) -> int:
        """Draw how often something is done, as far as time allows, and put it into the slot `count`."""
        fits = int((self.longest - 1.2) * self.tempo / period)
        return self.choose("count", {n: TIMES[n] for n in range(1, max(1, min(most, fits)) + 1)})

    def stand(self, seconds: float) -> Tracks:
        """Start from standing at ease for about so many seconds, kept within what a clip may last."""
        seconds = float(np.clip(seconds, SHORTEST + 0.2 * self.closed, self.longest))
        return Tracks.stand(round(seconds * self.fps) + 1, self.fps)

    def repeat(self, count: int, period: float, pause: float = 0.5) -> tuple[Tracks, np.ndarray, np.ndarray]:
        """Stand long enough to do something `count` times.

        Gives the tracks, the progress in [0, 1] of the repetition under way (0 before, 1 after) and its index.
        """
        lead, period = self.uniform(0.15, 0.15 + pause), period / self.tempo
        tracks = self.stand(lead + count * period + self.uniform(0.2, 0.2 + pause))
        phase = np.clip((tracks.time - lead) / period, 0, count * (1 - 1e-9))
        index = np.floor(phase).astype(int)
        return tracks, phase - index, index

    def during(self, rise: float = 0.6, fall: float = 0.6) -> tuple[Tracks, np.ndarray]:
        """Stand for a drawn time and take up a posture in the middle of it.

        Gives the tracks and how far the posture is taken up, 0 at both ends and 1 between.
        """
        tracks = self.stand(min(self.uniform(2.6, 6.5) / self.tempo, self.longest))
        return tracks, self.held(tracks, rise, fall)

    def held(self, tracks: Tracks, rise: float, fall: float) -> np.ndarray:
        """Return how far a posture is taken up that starts soon after the clip and ends shortly before it."""
        lead, tail = self.uniform(0.1, 0.3), self.uniform(0.1, 0.3)
        left = tracks.time[-1] - tracks.time
        return smooth((tracks.time - lead) / (rise / self.tempo)) * smooth((left - tail) / (fall / self.tempo))


@dataclass(frozen=True)
class Action:
    """Hold one action: its name, how it is performed (for the left side), and phrases that tell it.

    In a phrase, `*` marks a verb (given as its lemma) and `{slot}` what `perform` chose; `{side}` and `{other}` become
    left and right, `{turn}` and `{counter}` counterclockwise and clockwise, or the reverse in a mirrored performance.
    """

    name: str
    perform: Callable[[Plan], Tracks]
    phrases: tuple[str, ...]
    joins: bool


ACTIONS: dict[str, Action] = {}
"""Every action by its name."""


def action(*phrases: str, joins: bool = True) -> Callable[[Callable[[Plan], Tracks]], Callable[[Plan], Tracks]]:
    """Register a performance under its function's name; `joins`: it can start and end standing."""

    def register(perform: Callable[[Plan], Tracks]) -> Callable[[Plan], Tracks]:
        name = perform.__name__.replace("_", " ")
        ACTIONS[name] = Action(name, perform, phrases, joins)
        return perform

    return register
