"""Ask for motion whose joints are where a real motion has them, and measure by how much they miss (FRONTIER §2.8)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Int
from torch import Tensor

from kinema.evaluation.source import Together, answer
from kinema.evaluation.sources import encode_captions
from kinema.evaluation.together import Asked, by_length
from kinema.pipeline import TextToMotion
from kinema.pipeline.arguments import BATCH
from kinema.text.frozen import FrozenTextEncoder
from kinema.types import Known, MotionBatch

FAR = 0.5
"""Metres by which a joint misses its place, as OmniControl counts them."""
FRAMES = {"one": lambda n: 1, "two": lambda n: 2, "five": lambda n: 5, "quarter": lambda n: n // 4, "all": lambda n: n}
"""How many of a motion's n frames are held; OmniControl's 1, 2, 5, 49 and 196 of 196."""


class Controlled(Together):
    """Answer with motion in which joints stand where those of the real clip do, in frames drawn by its seed.

    The text is the clip's own, and so is the length. `density` is one of `FRAMES`, or "mixed": each motion has one of
    them, drawn too. What is held is known in space: a clip's first frame stands at the origin and faces +Z.
    """

    text_encoder: FrozenTextEncoder
    label = "controlled"

    def __init__(
        self,
        model: TextToMotion,
        *,
        joints: Sequence[str],
        density: str = "mixed",
        sampling: Any = None,
        batch_size: int = BATCH,
    ) -> None:
        skeleton = model.skeleton
        self.model, self.sampling, self.batch_size = model.eval(), sampling, batch_size
        self.densities = list(FRAMES) if density == "mixed" else [density]
        self.joints = torch.tensor([name in joints for name in skeleton.joint_names])
        self.meters, self.text_encoder = skeleton.meters, model.text_encoder
        self._missed: list[tuple[Tensor, Tensor]] = []

    def answer_all(self, questions: Sequence[Asked]) -> list[MotionBatch]:
        """Generate one motion per caption and keep how far its held joints are from their places."""
        return by_length(questions, self._generate, self.batch_size)

    def _generate(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        tokenizer = self.model.tokenizer
        real = tokenizer.encode(batch)
        held = self.held(batch.lengths, seeds, real.content.shape[1])
        keep = tokenizer.joint_numbers(held)
        known = Known(real.holding(real.content.masked_fill(~keep, 0.0), real.lengths, real.frames), keep)
        text = encode_captions(self.text_encoder, batch)
        latents = self.model.sample_latents(text, seeds=seeds, known=known, sampling=self.sampling)
        size = latents.content.shape[1]
        there, asked = (self.meters * tokenizer.joints(one.content[:, :size]) for one in (latents, real))
        self._missed.append(((there - asked).norm(dim=-1).cpu(), held[:, :size].cpu()))
        made = self.model.decode(latents)
        return answer(batch, made.features, made.lengths)

    def held(self, lengths: Int[Tensor, " b"], seeds: Int[Tensor, " b"], size: int) -> Bool[Tensor, "b t j"]:
        """Draw the frames in which a motion's joints are held; as often as it is asked, the same."""
        frames = torch.zeros(len(lengths), size, dtype=torch.bool)
        for row, length, seed in zip(frames, lengths.tolist(), seeds.tolist(), strict=True):
            rng = np.random.default_rng(seed)
            count = FRAMES[self.densities[rng.integers(len(self.densities))]](length)
            row[rng.choice(length, min(count, length), replace=False)] = True
        return (frames[..., None] & self.joints).to(lengths.device)

    def measured(self) -> dict[str, float]:
        """Return the mean miss (cm), and the shares of places and of motions that miss one by more than 50 cm."""
        missed, self._missed = self._missed, []
        shares = [(away * held > FAR).flatten(1).any(1).float() for away, held in missed]
        far = [away[held] for away, held in missed]
        if not far:
            return {}
        places, motions = torch.cat(far), torch.cat(shares)
        return {
            "control_cm": 100 * float(places.mean()),
            "control_places_missed": float((places > FAR).float().mean()),
            "control_motions_missed": float(motions.mean()),
        }
