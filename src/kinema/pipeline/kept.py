"""Encode what an edit keeps: each stretch by itself, so that nothing of what is regenerated leaks into it."""

from __future__ import annotations

import torch
from jaxtyping import Bool
from torch import Tensor

from kinema.tokenizers import MotionTokenizer
from kinema.types import Known, MotionBatch


def encode_kept(tokenizer: MotionTokenizer, motion: MotionBatch, keep: Bool[Tensor, "b n"]) -> Known:
    """Encode every stretch of kept latents (True) as a clip of its own, as the published editing does (BAD §5).

    An encoder's latents look sideways: encoded within the whole clip, those beside an edit would know the frames that
    it replaces. Positions that are not kept hold zeros. Raises ValueError for latents that have no place in time.
    """
    unit, lengths = tokenizer.space.in_time("keeping a part of a motion"), tokenizer.space.latents_of(motion.lengths)
    keep = keep & (torch.arange(keep.shape[1], device=keep.device) < lengths[:, None])
    rows, starts, ends = stretches(keep)
    if not len(rows):
        # Nothing is kept; the shape of the latents is all that is needed.
        latents = tokenizer.encode(motion)
        return Known(latents, keep)
    encoded = tokenizer.encode_pieces(motion, rows, starts * unit, (ends - starts) * unit)
    content = encoded.content.new_zeros(*keep.shape, encoded.content.shape[2])
    content[keep] = encoded.content[encoded.mask]
    return Known(encoded.holding(content, lengths, lengths * unit), keep)


def encode_kept_features(tokenizer: MotionTokenizer, motion: MotionBatch, keep: Bool[Tensor, "b n d"]) -> Known:
    """Encode frames of which single features, columns of feature rows, are kept (True); the others are zero.

    Raises ValueError for latents that aren't frames.
    """
    latents = tokenizer.encode(motion)
    keep = tokenizer.known_numbers(keep) & latents.mask[..., None]
    return Known(latents.holding(latents.content.masked_fill(~keep, 0.0), latents.lengths, latents.frames), keep)


def stretches(keep: Bool[Tensor, "b n"]) -> tuple[Tensor, Tensor, Tensor]:
    """Find the unbroken stretches of True: their rows, first positions and ends, in the mask's order."""
    border = torch.zeros(len(keep), 1, dtype=torch.int8, device=keep.device)
    steps = torch.cat((border, keep.to(torch.int8), border), dim=1).diff(dim=1)
    rows, starts = (steps == 1).nonzero(as_tuple=True)
    ends = (steps == -1).nonzero(as_tuple=True)[1]
    return rows, starts, ends
