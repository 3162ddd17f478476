"""Hold what all generators of codes owe: a space of codes, checked requests, and residual codes by a second network."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Int
from torch import Tensor, nn

from kinema.generators import Generator
from kinema.generators.texts import check_guidance
from kinema.generators.tokens.request import TokenRequest, check_codes, token_request
from kinema.generators.tokens.residual import ResidualSampling, ResidualTransformer
from kinema.types import Known, Latents, LatentSpace, TextFeatures

RESIDUAL = "residual"


class TokenGenerator(Generator):
    """Generate one code per position; a residual transformer, once attached, completes them (MoMask §4)."""

    parts = (RESIDUAL,)

    def __init__(self, *, codebook_size: int, max_latents: int, downsample: int, code_dim: int | None = None) -> None:
        super().__init__()
        self.codebook_size = codebook_size
        self.max_latents = max_latents
        self.base_space = LatentSpace("codes", code_dim, max_latents, downsample, codebook_size)
        self._residual: tuple[ResidualTransformer, ...] = ()  # a tuple: no submodule, so neither saved nor trained here

    @property
    def space(self) -> LatentSpace:  # type: ignore[override]
        """The codes that `sample` gives: of all layers with a residual transformer, else of the first."""
        return self._residual[0].completes(self.base_space) if self._residual else self.base_space

    def attach(self, part: str, module: nn.Module) -> None:
        """Take a residual transformer; raises ValueError for one that is made for other codes."""
        if part != RESIDUAL:
            super().attach(part, module)
        if not isinstance(module, ResidualTransformer):
            raise ValueError(f"a {type(module).__name__} is no residual transformer; give the run of a residual stage")
        module.completes(self.base_space)
        self._residual = (module,)

    def check_sampling(self, sampling: Any) -> None:
        """Refuse guidance that the training of an attached residual transformer gave no ground, too."""
        super().check_sampling(sampling)
        for residual in self._residual:
            check_guidance(residual.condition_drop, residual_guidance=self.residual_sampling(sampling).guidance)

    def request(
        self, text: TextFeatures, frames: Int[Tensor, " b"] | None, seeds: Int[Tensor, " b"], known: Known | None
    ) -> TokenRequest:
        """Check what `sample` is asked for; without any length a model that ends itself gets the longest."""
        open_end = self.predicts_length and frames is None and known is None
        if open_end:
            frames = torch.full((len(seeds),), self.base_space.frames_of(self.max_latents))
        device = next(self.parameters()).device
        return token_request(self.base_space, text, frames, seeds, known, device=device, open_end=open_end)

    def codes(self, latents: Latents) -> Int[Tensor, "b n"]:
        """Return a training batch's codes of the first layer, 0 at padding; raises ValueError for what is none."""
        return check_codes(latents, self.base_space)[..., 0]

    def latents(self, codes: Int[Tensor, "b n"], lengths: Int[Tensor, " b"]) -> Latents:
        """Pack codes of one layer."""
        return Latents(lengths=lengths, frames=self.base_space.frames_of(lengths), codes=codes[..., None])

    def completed(
        self, base: Latents, text: TextFeatures, *, seeds: Int[Tensor, " b"], known: Known | None, sampling: Any
    ) -> Latents:
        """Add the residual layers' codes if a residual transformer is attached; kept positions keep all of theirs."""
        for residual in self._residual:
            options = self.residual_sampling(sampling)
            base = residual.complete(base, text, seeds=seeds, known=known, sampling=options)
        return base

    def residual_sampling(self, sampling: Any) -> ResidualSampling:
        """Return the residual transformer's options; its defaults unless the family's sampling has some."""
        return ResidualSampling()
