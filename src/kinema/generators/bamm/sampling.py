"""Sample with BAMM: its options, and slots decoded behind the text alone or between conditions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.decoding.autoregressive import decode_left_to_right
from kinema.decoding.draws import Greedy, SeededDraws, TokenDraws
from kinema.generators.tokens.encoder import TokenEncoder
from kinema.generators.tokens.generator import TokenGenerator
from kinema.generators.tokens.targets import targets
from kinema.masking import lowest, masked_count
from kinema.nn.attention import KeyValueCache
from kinema.options import NonNegative, OneOf, OpenShare, Options, Steps
from kinema.registry import buildable
from kinema.types import frame_mask

REMASKS = ("confidence", "order")
REGENERATED = 0.5
"""The share of the codes that each iteration after the first generates again (BAMM, Generation)."""

SlotLogits = Callable[[int, Int[Tensor, "b n"]], Float[Tensor, "b k"]]
"""rows(slot, ids) -> the logits of a slot; the slots before it are decided."""


@buildable
@dataclass(frozen=True)
class BammSampling(Options):
    """Choose how codes are sampled.

    The first of `iterations` goes from left to right under `guidance`; each further one generates half of the codes
    again, the others being conditions, under `second_guidance` (edits too). `remask` chooses that half: the codes of
    least "confidence" (the paper), or by the draws' "order" (the published code ranks constant scores, so that its
    half is arbitrary). Temperature 0 takes the likeliest class. Published guidance is 4 on HumanML3D, 2 on KIT-ML;
    `residual_*` are for the residual transformer behind this one. `official_inference` repeats what the published code
    does: while codes are generated again, conditions are overwritten in the input as they are passed (and put back at
    the end), and edits ignore their text.
    """

    guidance: NonNegative = 4.0
    second_guidance: NonNegative = 3.0
    iterations: Steps = 2
    temperature: NonNegative = 1.0
    remask: Annotated[str, OneOf(REMASKS)] = "confidence"
    residual_guidance: NonNegative = 6.0
    residual_temperature: NonNegative = 1.0
    residual_top_k: OpenShare = 0.9
    residual_padding: bool = True
    official_inference: bool = False

    def draws(self, seeds: Int[Tensor, " b"]) -> TokenDraws:
        """Make what draws the codes of these seeds."""
        return SeededDraws(seeds) if self.temperature else Greedy(seeds)


class Slots(TokenGenerator):
    """What decoding needs of a model; calling it gives all positions' logits."""

    # A base class and no protocol: since Python 3.12 a check of a protocol overlooks a module's submodules.
    end: int
    pad: int
    token_embedding: nn.Embedding
    encoder: TokenEncoder


class SlotDecoder:
    """Decode slots for texts, each pass drawing by steps of its own."""

    def __init__(self, model: Slots, text: Float[Tensor, "b t"], draws: TokenDraws, sampling: BammSampling) -> None:
        self.model, self.text, self.draws, self.sampling = model, text, draws, sampling

    def generate(self, lengths: Int[Tensor, " b"], *, open_end: bool) -> tuple[Int[Tensor, "b n"], Int[Tensor, " b"]]:
        """Return codes and lengths; with `open_end` lengths are predicted, at most those given."""
        codes, lengths, confidence = self._behind_text(lengths, open_end)
        real = frame_mask(lengths, codes.shape[1])
        count = masked_count(lengths, torch.tensor(REGENERATED))
        for iteration in range(1, self.sampling.iterations):
            scores = confidence
            if self.sampling.remask == "order":
                scores = self.draws.order(codes.shape[1]).to(real.device)
            free = lowest(scores, real, count)
            codes, fresh = self.between(codes, real & ~free, lengths, self.sampling.second_guidance, iteration)
            confidence = torch.where(free, fresh, confidence)
        return codes, lengths

    def between(
        self,
        codes: Int[Tensor, "b n"],
        keep: Bool[Tensor, "b n"],
        lengths: Int[Tensor, " b"],
        guidance: float,
        iteration: int = 0,
    ) -> tuple[Int[Tensor, "b n"], Float[Tensor, "b n"]]:
        """Generate the codes below each length that `keep` leaves free; the others and END are conditions.

        Gives the codes, 0 at padding, and how likely those were that were drawn.
        """
        ids = targets(codes, lengths, self.model.end, self.model.pad)
        overwrite = self.sampling.official_inference and iteration > 0
        condition = F.pad(keep, (0, 1)) | (ids == self.model.end)
        real = frame_mask(lengths, codes.shape[1])
        if overwrite:
            rows = self._guided(lambda text: WholeRows(self.model, text, ids, condition), guidance)
        else:
            free = F.pad(real & ~keep, (0, 1))
            rows = self._guided(lambda text: CachedRows(self.model, text, ids, condition, free), guidance)
        draws = PassDraws(self.draws, self.sampling.temperature, iteration * self.model.max_latents)
        drawn, _ = decode_left_to_right(
            lambda slot, ids: rows(slot, ids)[:, : self.model.codebook_size],
            ids[:, :-1],
            lengths,
            draws,
            keep=None if overwrite else keep,
        )
        return torch.where(keep, codes, drawn).masked_fill(~real, 0), draws.confidence

    def _behind_text(
        self, lengths: Int[Tensor, " b"], open_end: bool
    ) -> tuple[Int[Tensor, "b n"], Int[Tensor, " b"], Float[Tensor, "b n"]]:
        """Generate all slots, each from the text and the slots before it."""
        model, size = self.model, int(lengths.max())
        ids = torch.zeros(len(lengths), size, dtype=torch.long, device=lengths.device)
        no, yes = torch.zeros_like(ids, dtype=torch.bool), torch.ones_like(ids, dtype=torch.bool)
        rows = self._guided(lambda text: CachedRows(model, text, ids, no, yes), self.sampling.guidance)
        draws = PassDraws(self.draws, self.sampling.temperature, 0)
        codes, lengths = decode_left_to_right(
            lambda slot, ids: rows(slot, ids)[:, : model.codebook_size + open_end],
            ids,
            lengths,
            draws,
            end=model.end if open_end else None,
        )
        lengths = lengths.clamp(min=1)
        size = int(lengths.max())
        return codes[:, :size], lengths, draws.confidence[:, :size]

    def _guided(self, make: Callable[[Tensor], SlotLogits], scale: float) -> SlotLogits:
        """Guide the logits of `make(text)`: empty + scale * (text - empty), both in one batch.

        Scale 1 takes the text alone and scale 0 the empty condition alone: one pass.
        """
        halves = [half for half, unused in ((self.text, 0), (torch.zeros_like(self.text), 1)) if scale != unused]
        rows = make(torch.cat(halves))

        def guided(slot: int, ids: Int[Tensor, "b n"]) -> Float[Tensor, "b k"]:
            logits = rows(slot, ids.repeat(len(halves), 1)).float().chunk(len(halves))
            return logits[-1] + scale * (logits[0] - logits[-1])

        return guided


class PassDraws:
    """Draw the slots of one pass by steps from `first` on, and keep how likely each draw was at temperature 1."""

    def __init__(self, draws: TokenDraws, temperature: float, first: int) -> None:
        self.draws, self.temperature, self.first = draws, temperature, first
        self.order = draws.order
        self._likely: list[Tensor] = []

    @property
    def confidence(self) -> Float[Tensor, "b n"]:
        """The probability of every draw so far."""
        return torch.cat(self._likely, dim=1)

    def pick(self, step: int, logits: Float[Tensor, "b 1 k"]) -> Int[Tensor, "b 1"]:
        """Draw one class."""
        token = self.draws.pick(self.first + step, logits / (self.temperature or 1.0))
        self._likely.append(logits.softmax(-1).gather(-1, token[..., None])[..., 0])
        return token


class CachedRows:
    """Return the logits of slot after slot from a cache.

    A condition's row sees conditions only, so what conditions (and the text) hold is computed once, before the first
    slot. From then on each slot takes one row, that of the slot before it: later rows see its key unless it is a
    condition's, which they see already. `ids` and the masks are repeated to the rows of `text`.
    """

    def __init__(
        self,
        model: Slots,
        text: Float[Tensor, "b t"],
        ids: Int[Tensor, "_ s"],
        condition: Bool[Tensor, "_ s"],
        free: Bool[Tensor, "_ s"],
    ) -> None:
        self.encoder, self.embedding = model.encoder, model.token_embedding
        self.needed = (free | free.roll(1, dims=1)).any(dim=0).tolist()
        ids, self.condition = (x.repeat(len(text) // len(x), 1) for x in (ids, condition))
        visible = F.pad(self.condition, (1, 0), value=True)
        first = (~visible).int().argsort(dim=1, stable=True)[:, : int(visible.sum(dim=1).max())]
        self.fixed = visible.gather(1, first)
        self.seen = torch.zeros_like(self.condition[:, :0])
        self.caches = [KeyValueCache(first.shape[1] + ids.shape[1]) for _ in self.encoder.blocks]
        x = self.encoder.embed(self.embedding(ids), self.encoder.text_projection(text)[:, None])
        x = x.gather(1, first[:, :, None].expand(-1, -1, x.shape[2]))
        self.logits = self.encoder(x, self.fixed, self.caches)[:, 0]

    def __call__(self, slot: int, ids: Int[Tensor, "b n"]) -> Float[Tensor, "b k"]:
        """Return the logits of `slot`; where neither it nor the slot before it is free in any sample, any logits."""
        if slot > 0 and self.needed[slot]:
            own = self.condition[:, slot - 1 : slot]
            self.seen = torch.cat((self.seen, ~own), dim=1)
            x = self.encoder.embed(self.embedding(ids[:, slot - 1 : slot]), start=slot)
            mask = torch.cat((self.fixed, self.seen & ~own), dim=1)
            self.logits = self.encoder(x, mask, self.caches)[:, 0]
        return self.logits


class WholeRows:
    """Return the logits of slot after slot by the whole sequence anew, so that conditions may change on the way."""

    def __init__(
        self, model: Slots, text: Float[Tensor, "b t"], ids: Int[Tensor, "_ s"], condition: Bool[Tensor, "_ s"]
    ) -> None:
        self.model, self.text = model, text
        self.last, self.condition = (x.repeat(len(text) // len(x), 1) for x in (ids[:, -1:], condition))

    def __call__(self, slot: int, ids: Int[Tensor, "b n"]) -> Float[Tensor, "b k"]:
        """Return the logits of `slot`."""
        return self.model(torch.cat((ids, self.last), dim=1), self.text, self.condition)[:, slot]
