"""Quantise vectors by a codebook that follows running means of what each code is chosen for (COMMON §4).

A quantiser is a module that `VQVAE` puts between its encoder and decoder (protocol `Quantizer`): this
codebook, a stack of them (rvq.py), or one that learns nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Protocol, runtime_checkable

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor, nn

from kinema.nn.ranks import gather_rows, largest
from kinema.options import Classes, NonNegative, OneOf, Share, Size, checked
from kinema.registry import buildable

RESETS = ("always", "unused")
PERIOD = 20
"""Steps between two resets of unused codes (each takes a step of its own: 20, 41, 62 ...)."""
NOISE = 0.01
"""Norm, about, of the noise that tells the copies of a repeated row apart."""
LEAST = 1e-12
"""Running counts below this say nothing: the code stays where it is."""


@dataclass
class Quantized:
    """Hold what a quantiser makes of vectors; values and codes are 0 at padding, the scalars are of real rows.

    `values` carry the gradient straight through to the input, `commit` draws the input to its code. `perplexity` is of
    this batch's codes (all ranks' in training); `dead_codes` is the share of codes that are (nearly) never chosen.
    `embedding` draws the codes to the input, where they are learned by gradients.
    """

    values: Float[Tensor, "b n d"]
    codes: Int[Tensor, "b n q"]
    commit: Float[Tensor, ""]
    perplexity: Float[Tensor, ""]
    dead_codes: Float[Tensor, ""]
    embedding: Float[Tensor, ""] | None = None


@runtime_checkable
class Quantizer(Protocol):
    """Quantise vectors (an nn.Module): `codebook_size` codes of `code_dim` numbers, `quantizers` per position."""

    codebook_size: int
    code_dim: int
    quantizers: int
    training: bool

    @property
    def codebooks(self) -> Float[Tensor, "q k d"]:
        """The code vectors of all layers."""

    def __call__(
        self,
        z: Float[Tensor, "b n d"],
        real: Bool[Tensor, "b n"],
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
    ) -> Quantized:
        """Quantise, and learn if in training mode; draws come from `generator`, for the global batch."""

    def lookup(self, codes: Int[Tensor, "b n q"]) -> Float[Tensor, "b n d"]:
        """Return the vectors of codes, zeros for -1; raises ValueError for an id out of range."""

    def train(self, mode: bool = True) -> Any:
        """Learn at each call, or (mode=False) don't."""


@dataclass
class CodebookDraws:
    """Hold what a training step draws for the rows of all ranks, repeated until there are as many as codes.

    Noises are None where nothing has to be repeated, `uniform` (this rank's positions) where codes are not sampled.
    """

    order: Int[Tensor, " m"]
    init_noise: Float[Tensor, "m d"] | None = None
    tile_noise: Float[Tensor, "m d"] | None = None
    uniform: Float[Tensor, "b n k"] | None = None

    @classmethod
    def draw(
        cls, rows: int, size: int, dim: int, generator: torch.Generator | None, device: torch.device
    ) -> CodebookDraws:
        """Draw for a batch of so many rows, of all ranks."""
        tiled = rows * math.ceil(size / max(rows, 1)) if rows < size else rows
        order = torch.rand(tiled, generator=generator, device=device).argsort()
        if tiled == rows:
            return cls(order)
        first, second = torch.randn(2, tiled, dim, generator=generator, device=device)
        return cls(order, first, second)


@buildable
class EMACodebook(nn.Module):
    """Vector quantiser whose codes are running means of the vectors that chose them (COMMON §4).

    A code is dead while its running count is below `threshold`. `reset` says when the dead are replaced by rows of the
    batch: "always", at each step (variant A: T2M-GPT, AttT2M, MotionGPT, MoMask, BAMM), or "unused", every 21st step
    and only those that never lived (variant B: MMM, BAD). Counts and sums of a replaced code stay, as published, so
    with "unused" it returns to its mean at the next step unless it was chosen in between.

    In training, codes are drawn from softmax(-distance² / `temperature`); 0 takes the nearest. All that the codebook
    learns from is gathered from all ranks, and all it remembers is in the state dict: a resumed run goes on exactly.
    """

    quantizers = 1
    codebook: Float[Tensor, "k d"]
    sums: Float[Tensor, "k d"]
    counts: Float[Tensor, " k"]
    initialised: Bool[Tensor, ""]
    used: Bool[Tensor, " k"]
    counter: Int[Tensor, ""]

    @checked
    def __init__(
        self,
        codebook_size: Classes = 512,
        code_dim: Size = 512,
        *,
        reset: Annotated[str, OneOf(RESETS)] = "always",
        decay: Share = 0.99,
        threshold: NonNegative = 1.0,
        temperature: NonNegative = 0.0,
    ) -> None:
        super().__init__()
        self.codebook_size, self.code_dim = codebook_size, code_dim
        self.reset, self.decay, self.threshold, self.temperature = reset, decay, threshold, temperature
        self.register_buffer("codebook", torch.zeros(codebook_size, code_dim))
        self.register_buffer("sums", torch.zeros(codebook_size, code_dim))
        self.register_buffer("counts", torch.zeros(codebook_size))
        self.register_buffer("initialised", torch.tensor(False))
        if reset == "unused":
            self.register_buffer("used", torch.zeros(codebook_size, dtype=torch.bool))
            self.register_buffer("counter", torch.tensor(0))
        self._initialised = False

    def forward(
        self,
        z: Float[Tensor, "b n d"],
        real: Bool[Tensor, "b n"],
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
        draws: CodebookDraws | None = None,
    ) -> Quantized:
        """Quantise by the codes as they are; in training mode, then learn from the real rows of all ranks.

        `draws` replaces all draws (tests).
        """
        with torch.autocast(z.device.type, enabled=False):
            z = z.float().masked_fill(~real[..., None], 0)
            if not self.training:
                return self._quantize(z, real, assign(z.detach(), self.codebook))[0]
            rows = gather_rows(z.detach()[real], shard[1])
            draws = draws or self._draw(z, len(rows), generator, shard)
            self._initialise(rows, draws)
            codes = assign(z.detach(), self.codebook, draws.uniform, self.temperature)
            quantized, chosen = self._quantize(z, real, codes, shard[1])
            self.update(rows, chosen, draws)
            quantized.dead_codes = self._dead()
            return quantized

    @property
    def codebooks(self) -> Float[Tensor, "1 k d"]:
        """The code vectors of the one layer."""
        return self.codebook[None]

    def lookup(self, codes: Int[Tensor, "b n 1"]) -> Float[Tensor, "b n d"]:
        """Return the vectors of codes, zeros for -1; raises ValueError for an id out of range."""
        return look_up(codes, self.codebook)

    @torch.no_grad()
    def start_from(self, codebook: Float[Tensor, "k d"]) -> None:
        """Take these codes and forget what was counted (the start of training; published files hold nothing else)."""
        self.codebook.copy_(codebook)
        self.sums.copy_(codebook)
        self.counts.fill_(1.0)
        self.initialised.fill_(True)
        self._initialised = True

    @torch.no_grad()
    def update(self, rows: Float[Tensor, "m d"], codes: Int[Tensor, " m"], draws: CodebookDraws) -> None:
        """Move the codes to the running means of their rows, then replace dead ones by rows of the batch."""
        if not len(rows):
            return
        sums, counts = accumulate(self.sums, self.counts, rows, codes, self.decay)
        self.sums.copy_(sums)
        self.counts.copy_(counts)
        means = torch.where(counts[:, None] > LEAST, sums / counts[:, None], self.codebook)
        candidates = tile(rows, self.codebook_size, draws.tile_noise)
        keep = counts >= self.threshold
        if self.reset == "unused":
            due = self.counter == PERIOD
            candidates = candidates[draws.order]
            self.used.logical_or_(keep & ~due)
            keep = keep | self.used | ~due
            self.counter.copy_(torch.where(due, 0, self.counter + 1))
        self.codebook.copy_(torch.where(keep[:, None], means, candidates[: self.codebook_size]))

    def _quantize(
        self, z: Float[Tensor, "b n d"], real: Bool[Tensor, "b n"], codes: Int[Tensor, "b n"], world: int = 1
    ) -> tuple[Quantized, Int[Tensor, " m"]]:
        """Return the result and the codes of all ranks' real rows."""
        codes = codes.masked_fill(~real, 0)
        nearest = F.embedding(codes, self.codebook)
        mask = real[..., None]
        commit = ((z - nearest).square() * mask).sum() / (mask.sum() * self.code_dim).clamp(min=1)
        values = (z + (nearest - z).detach()) * mask
        chosen = gather_rows(codes[real], world)
        return Quantized(values, codes[..., None], commit, perplexity(chosen, self.codebook_size), self._dead()), chosen

    def _initialise(self, rows: Float[Tensor, "m d"], draws: CodebookDraws) -> None:
        """Take the first rows as codes, once. The flag is looked up once: reading a buffer synchronises."""
        self._initialised = self._initialised or bool(self.initialised)
        if not self._initialised:
            self.start_from(tile(rows, self.codebook_size, draws.init_noise)[: self.codebook_size])

    def _draw(
        self, z: Float[Tensor, "b n d"], rows: int, generator: torch.Generator | None, shard: tuple[int, int]
    ) -> CodebookDraws:
        draws = CodebookDraws.draw(rows, self.codebook_size, self.code_dim, generator, z.device)
        if self.temperature:
            (batch, positions, _), (rank, world) = z.shape, shard
            size = (batch * world, largest(positions, world, z.device), self.codebook_size)
            uniform = torch.rand(size, generator=generator, device=z.device)
            draws.uniform = uniform[rank * batch : (rank + 1) * batch, :positions]
        return draws

    def _dead(self) -> Float[Tensor, ""]:
        return (self.counts < self.threshold).float().mean()

    def _load_from_state_dict(self, *args: Any, **kwargs: Any) -> None:
        self._initialised = False
        super()._load_from_state_dict(*args, **kwargs)


def look_up(codes: Int[Tensor, "b n 1"], codebook: Float[Tensor, "k d"]) -> Float[Tensor, "b n d"]:
    """Return the vectors of codes, zeros for -1; raises ValueError for an id out of range."""
    wrong = codes[(codes < -1) | (codes >= len(codebook))]
    if len(wrong):
        raise ValueError(
            f"token id {wrong[0].item()} is out of range; this codebook has the ids 0 to {len(codebook) - 1} "
            "(-1: no code): use the tokenizer that the tokens were made with"
        )
    codes = codes[..., 0]
    return F.embedding(codes.clamp(min=0), codebook) * (codes >= 0)[..., None]


def assign(
    z: Float[Tensor, "*b d"],
    codebook: Float[Tensor, "k d"],
    uniform: Float[Tensor, "*b k"] | None = None,
    temperature: float = 0.0,
) -> Int[Tensor, "*b"]:
    """Choose the nearest code, or by Gumbel noise from `uniform` one of softmax(-distance² / temperature)."""
    near = 2 * z @ codebook.T - codebook.square().sum(1)  # -distance², but for what all codes share
    if uniform is None:
        return near.argmax(-1)
    gumbel = -((-uniform.clamp(min=1e-20).log()).clamp(min=1e-20).log())
    return (near / temperature + gumbel).argmax(-1)


def accumulate(
    sums: Float[Tensor, "k d"],
    counts: Float[Tensor, " k"],
    rows: Float[Tensor, "m d"],
    codes: Int[Tensor, " m"],
    decay: float,
) -> tuple[Float[Tensor, "k d"], Float[Tensor, " k"]]:
    """Mix the sums and counts of this batch's rows per code into the running ones."""
    batch_sums = torch.zeros_like(sums).index_add_(0, codes, rows)
    batch_counts = torch.bincount(codes, minlength=len(counts)).to(counts.dtype)
    return sums * decay + batch_sums * (1 - decay), counts * decay + batch_counts * (1 - decay)


def tile(rows: Float[Tensor, "m d"], size: int, noise: Float[Tensor, "n d"] | None = None) -> Float[Tensor, "n d"]:
    """Repeat the rows until there are `size`, told apart by scaled noise; as they are if there are enough."""
    if len(rows) >= size:
        return rows
    if not len(rows):
        raise ValueError("the first batch holds no real position to start the codebook from; give longer motions")
    repeated = rows.repeat(math.ceil(size / len(rows)), 1)
    return repeated if noise is None else repeated + noise * (NOISE / math.sqrt(rows.shape[1]))


def perplexity(codes: Shaped[Tensor, " m"], size: int) -> Float[Tensor, ""]:
    """Return the exponential of the entropy of the codes in use: about how many are used evenly."""
    share = torch.bincount(codes, minlength=size).float() / max(len(codes), 1)
    return torch.exp(-(share * torch.log(share + 1e-7)).sum())
