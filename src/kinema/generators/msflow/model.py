"""Generate motion as MSFlow does: a flow on frames, without an autoencoder, under the words of a text (FRONTIER §2)."""

from __future__ import annotations

from typing import Annotated

from jaxtyping import Bool
from torch import Tensor

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.errors import per_sequence
from kinema.diffusion.flow import Flow
from kinema.generators.frames.generator import FrameDiffusion
from kinema.generators.frames.sampling import FrameSampling
from kinema.generators.msflow.denoiser import TEXT_ATTENTION, MsflowDenoiser
from kinema.generators.msflow.masks import MASKS
from kinema.generators.texts import without_text, without_words
from kinema.options import Depth, OneOf, OptionalDepth, Share, Size, checked
from kinema.registry import buildable
from kinema.types import TextFeatures


@buildable
class MSFlow(FrameDiffusion):
    """Flow in motion space (FRONTIER §2): XYZ, all or the essential dims, as the tokenizer gives them.

    `process` is a `Flow`, published with prediction "x1" and source_scale 5. The other options are those of
    `MsflowDenoiser`. Without `null_tokens` a dropped text has zeros in place of its words' features, so that its length
    is still seen, as published.
    """

    denoiser: MsflowDenoiser

    @checked
    def __init__(
        self,
        *,
        frame_dim: Size,
        process: DDPM | Flow,
        token_dim: Size,
        width: Size = 512,
        feedforward: Size = 1024,
        layers: Depth = 8,
        heads: Size = 4,
        patch: Size = 1,
        mask: Annotated[str, OneOf(MASKS)] = "bidirectional",
        mask_block: Size = 1,
        text_attention: Annotated[str, OneOf(TEXT_ATTENTION)] = "joint",
        refiner_layers: OptionalDepth = 2,
        null_tokens: OptionalDepth = 0,
        shared_modulation: bool = False,
        condition_drop: Share = 0.1,
        max_frames: Size = 196,
        sampling: FrameSampling | None = None,
    ) -> None:
        denoiser = MsflowDenoiser(
            frame_dim,
            token_dim=token_dim,
            width=width,
            feedforward=feedforward,
            layers=layers,
            heads=heads,
            patch=patch,
            mask=mask,
            mask_block=mask_block,
            text_attention=text_attention,
            refiner_layers=refiner_layers,
            null_tokens=null_tokens,
            shared_modulation=shared_modulation,
        )
        super().__init__(
            denoiser,
            process,
            frame_dim=frame_dim,
            max_frames=max_frames,
            condition_drop=condition_drop,
            mask_frames=True,
            average=per_sequence,
            sampling=sampling or FrameSampling(guidance=3.0, solver="heun", solver_steps=49),
        )

    def without_text(self, text: TextFeatures, drop: Bool[Tensor, " b"] | None = None) -> TextFeatures:
        """Hide the words of the samples in `drop` (None: of all) behind the null tokens, or zero their features."""
        return without_text(text, drop) if self.denoiser.words.null is None else without_words(text, drop)
