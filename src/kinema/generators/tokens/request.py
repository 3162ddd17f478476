"""Check what a generator is given and asked for: lengths, codes, known latents."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from kinema.types import Known, Latents, TextFeatures, frame_mask


@dataclass(frozen=True)
class TokenRequest:
    """Hold a checked request for tokens: lengths, frames and what is known (`codes` are 0 where `keep` is False)."""

    lengths: Int[Tensor, " b"]
    frames: Int[Tensor, " b"]
    codes: Int[Tensor, "b n q"]
    keep: Bool[Tensor, "b n"]

    @property
    def real(self) -> Bool[Tensor, "b n"]:
        """True at positions before each sample's end."""
        return frame_mask(self.lengths, self.keep.shape[1])


def latent_lengths(frames: Int[Tensor, " b"], downsample: int, max_latents: int) -> Int[Tensor, " b"]:
    """Count the whole latents in `frames`; raise ValueError for less than one or more than `max_latents`."""
    lengths = frames // downsample
    wrong = frames[(lengths < 1) | (lengths > max_latents)]
    if len(wrong):
        raise ValueError(
            f"cannot generate {wrong[0].item()} frames; give {downsample} to {max_latents * downsample} frames "
            f"(1 to {max_latents} latents)"
        )
    return lengths


def check_codes(latents: Latents, codebook_size: int, max_latents: int, quantizers: int = 1) -> Int[Tensor, "b n q"]:
    """Return a batch's codes, 0 at padding; raise ValueError for values, ids out of range or too many positions."""
    codes = latents.codes
    if codes is None or codes.shape[2] < quantizers:
        found = "continuous values" if codes is None else f"{codes.shape[2]} codes per position"
        raise ValueError(f"this generator was built for {quantizers} codes per position, the tokenizer gives {found}")
    if codes.shape[1] > max_latents:
        raise ValueError(f"{codes.shape[1]} tokens exceed max_latents={max_latents}; raise it or crop the motions")
    codes = codes[..., :quantizers].masked_fill(~latents.mask[..., None], 0).long()
    wrong = codes[(codes < 0) | (codes >= codebook_size)]
    if len(wrong):
        raise ValueError(
            f"token id {wrong[0].item()} is out of range; this generator's codebook_size={codebook_size} allows 0 to "
            f"{codebook_size - 1}: use the tokenizer it was made for"
        )
    return codes


def token_request(
    text: TextFeatures,
    frames: Int[Tensor, " b"] | None,
    seeds: Int[Tensor, " b"],
    known: Known | None,
    *,
    codebook_size: int,
    downsample: int,
    max_latents: int,
    device: torch.device,
    quantizers: int = 1,
) -> TokenRequest:
    """Check a request for codes of given (or known) lengths; raise ValueError that names what doesn't fit."""
    if frames is None and known is None:
        raise ValueError("frames is None; give the frames to generate (a LengthEstimator predicts them from text)")
    frames = known.latents.lengths * downsample if frames is None else frames
    lengths = latent_lengths(frames.to(device), downsample, max_latents)
    if not len(lengths) == len(text.pooled) == len(seeds):
        raise ValueError(
            f"{len(lengths)} lengths, {len(text.pooled)} texts and {len(seeds)} seeds; give one of each per sample"
        )
    size = int(lengths.max())
    codes = torch.zeros(len(lengths), size, quantizers, dtype=torch.long, device=device)
    keep = torch.zeros(len(lengths), size, dtype=torch.bool, device=device)
    if known is not None:
        given = check_codes(known.latents, codebook_size, known.mask.shape[1], quantizers)
        if given.shape[:2] != known.mask.shape:
            raise ValueError(
                f"known codes are {tuple(given.shape)} with a mask {tuple(known.mask.shape)}; give one mask entry per "
                "position"
            )
        if not torch.equal(known.latents.lengths.to(device), lengths):
            raise ValueError(
                f"known latents have lengths {known.latents.lengths.tolist()} but {lengths.tolist()} are asked for; "
                "pass frames=None to keep the source's lengths"
            )
        keep = known.mask[:, :size].to(device) & frame_mask(lengths, size)
        codes = torch.where(keep[..., None], given[:, :size].to(device), codes)
    return TokenRequest(lengths, lengths * downsample, codes, keep)
