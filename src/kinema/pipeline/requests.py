"""Spread prompts into the motions that are asked for, each with a seed that nothing else of the request changes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from kinema.options import Count, check_value
from kinema.pipeline.arguments import check_length, frames_in
from kinema.seeds import request_seeds
from kinema.text.prompts import Prompt

Kind = tuple[str, int | None, int | None, float | None, str | None]


@dataclass(frozen=True)
class Take:
    """Hold one motion that is asked for: which of the request it is and of its prompt, from 1, and its seed."""

    index: int
    take: int
    seed: int
    prompt: Prompt

    def frames(self, usual: int | None, fps: float) -> int | None:
        """Return the frames that its prompt says, else the usual ones (None: the model's to say)."""
        if self.prompt.seconds is not None:
            return frames_in(self.prompt.seconds, fps)
        return usual if self.prompt.frames is None else self.prompt.frames


def frames_of(asked: Sequence[Take], usual: int | None, *, fps: float, maximum: int, fix: str) -> list[int | None]:
    """Return the frames of each take; None is the model's to say. Raises ValueError naming the prompt's line."""
    counts = [take.frames(usual, fps) for take in asked]
    for take, count in zip(asked, counts, strict=True):
        where = take.prompt.where
        if count is not None:
            check_length(count, maximum, fps, fix, "" if where is None else f"{where}: ")
    return counts


def takes_of(prompts: Sequence[Prompt], *, count: int = 1, seed: int | None = None) -> list[Take]:
    """Ask for `count` motions of each prompt that doesn't say its own; prompt by prompt, take by take.

    A prompt's own seed, else `seed`, else one that is drawn for it, is that of its first take; further ones follow from
    it (`request_seeds`), whatever other prompts there are. A prompt that comes again with the same seed is continued.
    """
    check_value(count, Count, "count")
    sizes = [count if prompt.count is None else prompt.count for prompt in prompts]
    kinds = [_kind(prompt, seed) for prompt in prompts]
    whole: Counter[Kind] = Counter()
    for kind, size in zip(kinds, sizes, strict=True):
        whole[kind] += size
    seeds = {kind: enumerate(request_seeds(kind[1], size), 1) for kind, size in whole.items()}
    every = [(prompt, kind) for prompt, kind, size in zip(prompts, kinds, sizes, strict=True) for _ in range(size)]
    return [Take(index, *next(seeds[kind]), prompt) for index, (prompt, kind) in enumerate(every, 1)]


def _kind(prompt: Prompt, seed: int | None) -> Kind:
    """Tell apart what would be one and the same motion."""
    # Every line of a manifest is a motion of its own: two may be of one text and seed, in different formats.
    file = None if prompt.entry is None else prompt.entry.file
    return prompt.text, seed if prompt.seed is None else prompt.seed, prompt.frames, prompt.seconds, file
