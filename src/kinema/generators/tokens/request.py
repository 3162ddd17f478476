"""Check what a generator is given and asked for: lengths, codes, known latents."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from kinema.generators.lengths import requested_lengths
from kinema.types import Known, Latents, LatentSpace, TextFeatures, frame_mask


@dataclass(frozen=True)
class TokenRequest:
    """Hold a checked request for tokens: lengths, frames and what is known (`codes` are 0 where `keep` is False).

    `open_end`: no length was asked for; the lengths are the longest there are.
    """

    lengths: Int[Tensor, " b"]
    frames: Int[Tensor, " b"]
    codes: Int[Tensor, "b n q"]
    keep: Bool[Tensor, "b n"]
    open_end: bool = False

    @property
    def real(self) -> Bool[Tensor, "b n"]:
        """True at positions before each sample's end."""
        return frame_mask(self.lengths, self.keep.shape[1])


def check_codes(latents: Latents, space: LatentSpace, most: int | None = None) -> Int[Tensor, "b n q"]:
    """Return a batch's codes of the space's layers, 0 at padding.

    Raises ValueError for values, ids out of range or more than `most` positions (default: the space's).
    """
    codes, size, most = latents.codes, space.codebook_size, most or space.most
    if codes is None or codes.shape[2] < space.quantizers:
        found = "continuous values" if codes is None else f"{codes.shape[2]} codes per position"
        raise ValueError(
            f"this generator was built for {space.quantizers} codes per position, the tokenizer gives {found}"
        )
    if codes.shape[1] > most:
        raise ValueError(f"{codes.shape[1]} tokens exceed max_latents={most}; raise it or crop the motions")
    assert size is not None  # a space of codes says how many
    codes = codes[..., : space.quantizers].masked_fill(~latents.mask[..., None], 0).long()
    wrong = codes[(codes < 0) | (codes >= size)]
    if len(wrong):
        raise ValueError(
            f"token id {wrong[0].item()} is out of range; this generator's codebook_size={size} allows 0 to "
            f"{size - 1}: use the tokenizer it was made for"
        )
    return codes


def token_request(
    space: LatentSpace,
    text: TextFeatures,
    frames: Int[Tensor, " b"] | None,
    seeds: Int[Tensor, " b"],
    known: Known | None,
    *,
    device: torch.device,
    open_end: bool = False,
) -> TokenRequest:
    """Check a request for codes of given (or known) lengths; raise ValueError that names what doesn't fit."""
    lengths = requested_lengths(space, text, frames, seeds, known, device=device)
    size = int(lengths.max())
    codes = torch.zeros(len(lengths), size, space.quantizers, dtype=torch.long, device=device)
    keep = torch.zeros(len(lengths), size, dtype=torch.bool, device=device)
    if known is not None:
        given = check_codes(known.latents, space, known.mask.shape[1])
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
    return TokenRequest(lengths, space.frames_of(lengths), codes, keep, open_end)
