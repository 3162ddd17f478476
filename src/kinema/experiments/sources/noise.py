"""Score decoded noise that is like a tokenizer's latents or codes one by one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from kinema.experiments.sources.base import ScoredSource
from kinema.experiments.stages.tokenizer import TokenizerStage

if TYPE_CHECKING:
    from torch import Tensor

    from kinema.evaluation.source import Source
    from kinema.experiments.evaluation import Row
    from kinema.experiments.scoring import Scorer

BATCHES = 16
"""Batches of training clips that say how latents are distributed."""


class NoiseSource(ScoredSource):
    """Decode noise of the training latents' mean and deviation, or codes as often as training clips have them."""

    name = "noise"
    scores = TokenizerStage.name

    def open(self, scorer: Scorer, row: Row) -> Source:
        """Make what answers."""
        import torch

        from kinema.evaluation.sources import NoiseCodes, NoiseLatents
        from kinema.experiments.instantiate import read_model

        ((part, run),) = row.subject.items()
        tokenizer = read_model(run, part).to(scorer.device)
        rows = _training_latents(scorer, tokenizer)
        if tokenizer.space.kind != "codes":
            return NoiseLatents(tokenizer, rows.mean(0), rows.std(0))
        counts = [torch.bincount(layer, minlength=tokenizer.space.codebook_size) for layer in rows.T]
        return NoiseCodes(tokenizer, torch.stack(counts) / len(rows))


def _training_latents(scorer: Scorer, tokenizer: Any) -> Tensor:
    """Return the values or codes of a part of the training clips, one row per position."""
    import torch

    protocol, data = scorer.protocol, scorer.clips(tokenizer.representation.kind)
    drawn = data.test_batches("train", 0, seed=protocol.seed, batch_size=protocol.pool)
    rows = []
    with torch.no_grad():
        for _, batch in zip(range(BATCHES), drawn, strict=False):
            latents = tokenizer.encode(batch.to(scorer.device))
            rows.append(latents.content[latents.mask])
    return torch.cat(rows)
