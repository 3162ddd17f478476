"""Check the lengths that a generator is asked for."""

from __future__ import annotations

import torch
from jaxtyping import Int
from torch import Tensor

from kinema.types import Known, LatentSpace, TextFeatures


def requested_lengths(
    space: LatentSpace,
    text: TextFeatures,
    frames: Int[Tensor, " b"] | None,
    seeds: Int[Tensor, " s"],
    known: Known | None,
    *,
    device: torch.device,
) -> Int[Tensor, " b"]:
    """Count the latents of each sample, of `frames` or else of what is known.

    Raises ValueError without either, for frames that the space has no latents for, or unless there is one text and one
    seed per sample.
    """
    if frames is None:
        if known is None:
            raise ValueError("frames is None; give the frames to generate (a LengthEstimator predicts them from text)")
        frames = known.latents.frames if space.unit is None else space.frames_of(known.latents.lengths)
    lengths = latent_lengths(frames.to(device), space)
    if not len(lengths) == len(text.pooled) == len(seeds):
        raise ValueError(
            f"{len(lengths)} lengths, {len(text.pooled)} texts and {len(seeds)} seeds; give one of each per sample"
        )
    return lengths


def latent_lengths(frames: Int[Tensor, " b"], space: LatentSpace) -> Int[Tensor, " b"]:
    """Count the whole latents in `frames`; raise ValueError for less than one or more than the space's most."""
    lengths = space.latents_of(frames)
    wrong = frames[(lengths < 1) | (lengths > space.most)]
    if len(wrong):
        raise ValueError(
            f"cannot generate {wrong[0].item()} frames; give {space.frames_of(1)} to {space.frames_of(space.most)} "
            f"frames (1 to {space.most} latents)"
        )
    return lengths
