"""Answer as one who knows only a part of what the prompt's motion shows: ceilings to read methods against."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Int
from torch import Tensor

from kinema.data.labels import Shown
from kinema.evaluation.source import Source
from kinema.evaluation.sources import UNIT, TrainingClips, trained_answer
from kinema.types import MotionBatch

KNOWS = ("action", "style")


class Oracle(Source):
    """Answer with a training clip of the right action in another style, or of the right style in another action.

    Drawn by the row's seed, equally among such clips, and cut as `trained_answer` does. Clips are as mirrored as the
    prompt's, since labels don't say what mirrored clips show. A label without a style is all action: one who knows the
    action answers with it. Who knows nothing of a prompt (its style, and it has none; a label that training lacks, or
    has in no other pair) answers with a clip of any other label; `oracle_knew` is the share of the other prompts.

    Args:
        shown: says what an entry shows, of training and of the prompts.
        knows: "action" or "style".
    """

    multimodal = True

    def __init__(
        self,
        store: TrainingClips,
        entries: Sequence[int] | np.ndarray,
        shown: Callable[[int], Shown],
        *,
        knows: str,
        unit: int = UNIT,
    ) -> None:
        if knows not in KNOWS:
            raise ValueError(f"an oracle knows {knows!r}; allowed: {', '.join(KNOWS)}")
        self.store, self.shown, self.knows, self.unit = store, shown, knows, unit
        self.label = f"oracle, right {knows} only"
        self.known: dict[Shown, list[int]] = {}
        for entry in map(int, entries):
            self.known.setdefault(shown(entry), []).append(entry)
        if min(Counter(one.mirrored for one in self.known).values(), default=0) < 2:
            raise ValueError("the training clips have fewer than two labels; an oracle answers with another one's clip")
        self.found: dict[Shown, tuple[list[int], bool]] = {}
        self.answered = self.knew = 0

    def __call__(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        """Draw a clip for every row."""
        chosen = []
        for (entry, _, _), seed in zip(batch.crops, seeds.tolist(), strict=True):
            clips, knew = self.clips(self.shown(entry))
            chosen.append(clips[int(np.random.default_rng(seed).integers(len(clips)))])
            self.answered, self.knew = self.answered + 1, self.knew + knew
        return trained_answer(batch, self.store, chosen, self.unit)

    def clips(self, prompt: Shown) -> tuple[list[int], bool]:
        """Return the training clips that a prompt may be answered with, and whether anything of it was known."""
        if prompt not in self.found:
            sided = [one for one in self.known if one.mirrored == prompt.mirrored]
            right = [one for one in sided if self._right(prompt, one)]
            labels = right or [one for one in sided if one != prompt]
            self.found[prompt] = sorted(entry for one in labels for entry in self.known[one]), bool(right)
        return self.found[prompt]

    def measured(self) -> dict[str, float]:
        """Return the share of prompts of which something was known."""
        share = self.knew / max(1, self.answered)
        self.answered = self.knew = 0
        return {"oracle_knew": share}

    def _right(self, prompt: Shown, one: Shown) -> bool:
        if self.knows == "style":
            return prompt.style is not None and one.style == prompt.style and one.action != prompt.action
        return one.action == prompt.action and (prompt.style is None or one.style != prompt.style)
