"""Denoise motion with MSFlow's two streams, motion and words (FRONTIER §2.2)."""

from __future__ import annotations

from functools import partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.generators.frames.denoiser import Denoiser, Read
from kinema.generators.msflow.masks import MASKS, sees
from kinema.generators.msflow.refiner import Refiner, masked_mean
from kinema.nn.embeddings import timestep_embedding
from kinema.nn.rows import Rows
from kinema.nn.streams import CrossBlock, JointBlock, initialize
from kinema.nn.words import Words
from kinema.types import TextFeatures

TEXT_ATTENTION = ("joint", "cross")
FREQUENCIES = 256


class MsflowDenoiser(Denoiser):
    """Transformer over `patch` frames a token, under the words of the text and the time.

    `text_attention`: "joint" lets two streams attend to each other, "cross" lets motion attend to the words. Before
    that, `refiner_layers` let the words attend to each other, under the time if the refiner is timed: else they, and
    with "cross" the keys and values of every block, are the same for all times, and a sampler pays for them once.
    `mask` "causal" hides later blocks of `mask_block` tokens. `null_tokens` learnt tokens stand in front of the words
    (0: none), so that a text without words is these alone, whatever its length was. `shared_modulation` reads shifts,
    scales and gates once for all blocks.
    """

    def __init__(
        self,
        frame_dim: int,
        *,
        token_dim: int,
        width: int = 512,
        feedforward: int = 1024,
        layers: int = 8,
        heads: int = 4,
        patch: int = 1,
        mask: str = "bidirectional",
        mask_block: int = 1,
        text_attention: str = "joint",
        refiner_layers: int = 2,
        refiner_timed: bool = True,
        null_tokens: int = 0,
        shared_modulation: bool = False,
    ) -> None:
        super().__init__()
        self.width, self.patch, self.causal, self.mask_block = width, patch, mask == MASKS[1], mask_block
        hidden = 2 * feedforward // 3
        self.motion_in = nn.Linear(patch * frame_dim, width)
        self.motion_out = nn.Linear(width, patch * frame_dim)
        self.words = Words(token_dim, width, null_tokens)
        self.refiner = Refiner(width, heads, refiner_layers, timed=refiner_timed) if refiner_layers else None
        self.refines_once = not refiner_layers or not refiner_timed
        self.time = nn.Sequential(nn.Linear(FREQUENCIES, width), nn.SiLU(), nn.Linear(width, width))
        self.pooled = nn.Linear(width, width)
        self.joint = text_attention == TEXT_ATTENTION[0]
        self.modulation = nn.Linear(width, 6 * width) if shared_modulation else None
        self.blocks = nn.ModuleList(
            JointBlock(width, heads, hidden, shared=shared_modulation, last=i == layers - 1)
            if self.joint
            else CrossBlock(width, heads, hidden, cross=True, shared=shared_modulation)
            for i in range(layers)
        )
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Initialise: Xavier-uniform Linears, N(0, .02) time and null tokens, zero modulations, gates and output."""
        initialize(self)
        for layer in self.time:
            if isinstance(layer, nn.Linear):
                nn.init.normal_(layer.weight, std=0.02)
        self.words.reset_parameters()
        if self.refiner is not None:
            self.refiner.reset_parameters()
        for last in (self.motion_out, self.modulation):
            if last is not None:
                nn.init.zeros_(last.weight)

    def read(self, text: TextFeatures) -> Read:
        """Read each word, behind the learnt tokens if there are any; behind its numbers stands what blocks ask of it.

        That is keys and values of every block, where they are the same at all times.
        """
        words, mask = self.words(text)
        if not self.refines_once:
            return words, mask
        words = words if self.refiner is None else self.refiner(words, mask)
        return (words if self.joint else torch.cat((words, self._held(words, Rows(mask))), dim=-1)), mask

    def forward(
        self,
        x: Float[Tensor, "b t d"],
        time: Tensor,
        condition: Float[Tensor, "b l k"],
        seen: Bool[Tensor, "b l"] | None = None,
        real: Bool[Tensor, "b t"] | None = None,
        step: Float[Tensor, "n w"] | None = None,
    ) -> Float[Tensor, "b t d"]:
        """Predict at one time for all rows or one per row; no frame sees those that `real` says are padding.

        `step` is added to what is read of the time: how large a step the prediction is for.
        """
        frames = x.shape[1]
        words = torch.ones_like(condition[..., 0], dtype=torch.bool) if seen is None else seen
        shown = torch.ones_like(x[..., 0], dtype=torch.bool) if real is None else real
        # A token of several frames may hold padding beside the motion's last frames.
        x = F.pad(x * shown[..., None], (0, 0, 0, -frames % self.patch))
        text, held = condition[..., : self.width], condition[..., self.width :]
        if self.refiner is not None and not self.refines_once:
            text = self.refiner(text, words, time)
        moment = self._embed_time(time) if step is None else self._embed_time(time) + step
        c = F.silu(moment + self.pooled(masked_mean(text, words)))
        c = c if self.modulation is None else self.modulation(c)
        rows = Rows(shown[:, :: self.patch])
        motion = self.motion_in(rows.pack(x.unflatten(1, (-1, self.patch)).flatten(2)))
        sight = partial(sees, words, rows.real, causal=self.causal, block=self.mask_block)
        if self.joint:
            motion = self._beside(motion, rows, text, Rows(words), c, sight())
        else:
            size = words.shape[1]
            own = sight()[:, :, size:, size:] if self.causal else None
            held = held if self.refines_once else self._held(text, Rows(words))
            for block, part in zip(self.blocks, held.chunk(len(self.blocks), dim=-1), strict=True):
                motion = block(motion, rows, c, own, part, words)
        return rows.pad(self.motion_out(motion)).unflatten(2, (self.patch, -1)).flatten(1, 2)[:, :frames]

    def _beside(self, motion: Tensor, rows: Rows, text: Tensor, words: Rows, c: Tensor, mask: Tensor) -> Tensor:
        text = words.pack(text)
        for block in self.blocks:
            motion, text = block(motion, rows, text, words, c, mask)
        return motion

    def _held(self, text: Float[Tensor, "b l w"], words: Rows) -> Float[Tensor, "b l k"]:
        """Let every block read the words."""
        packed = words.pack(text)
        crosses = (block.cross for block in self.blocks if isinstance(block, CrossBlock))
        return torch.cat([cross.read(packed, words) for cross in crosses if cross is not None], dim=-1)

    def _embed_time(self, time: Tensor) -> Float[Tensor, "n w"]:
        """Embed a single time (one row, broadcast later) or one time per row, unscaled."""
        embedded = timestep_embedding(time.reshape(-1), FREQUENCIES)
        return self.time(embedded.to(self.motion_in.weight.dtype))
