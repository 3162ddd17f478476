"""Check what generators of continuous latents and of frames are given: training batches, and what an edit keeps."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from kinema.types import Known, Latents, LatentSpace


def check_latents(latents: Latents, space: LatentSpace) -> Float[Tensor, "b n c"]:
    """Return a batch's values; raises ValueError for codes, another number of channels or too many positions."""
    values, channels, most = latents.values, space.width, space.most
    frames = space.kind == "frames"
    if values is None or values.shape[2] != channels:
        found = "codes" if values is None else f"values of {values.shape[2]} channels"
        option = "frame_dim" if frames else "latent_dim"
        raise ValueError(f"this generator was built for values of {channels} channels ({option}), not for {found}")
    if values.shape[1] > most:
        what, option = ("frames", "max_frames") if frames else ("latents", "max_latents")
        raise ValueError(f"{values.shape[1]} {what} exceed {option}={most}; raise it or crop the motions")
    return values


def check_known(
    known: Known, lengths: Int[Tensor, " b"], width: int, *, features: bool = False
) -> Float[Tensor, "b n c"]:
    """Return the values of which some are known; raises ValueError for another shape or length.

    `features`: the mask may be over channels too.
    """
    values, mask = known.latents.values, known.mask
    if values is None or values.shape[2] != width or values.shape[: mask.ndim if features else 2] != mask.shape:
        shape = "codes" if values is None else tuple(values.shape)
        raise ValueError(
            f"known latents are {shape} with a mask {tuple(mask.shape)}; give values (samples, positions, {width}) and "
            f"one mask entry per position{', or per position and feature' if features else ''}"
        )
    if not torch.equal(known.latents.lengths.to(lengths.device), lengths):
        raise ValueError(
            f"known latents have lengths {known.latents.lengths.tolist()} but {lengths.tolist()} are asked for; "
            f"pass frames=None to keep the source's lengths"
        )
    return values
