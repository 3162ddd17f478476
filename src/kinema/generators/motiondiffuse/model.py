"""Generate frames as MotionDiffuse does: stylised attention to frames and words predicts the noise (MotionDiffuse)."""

from __future__ import annotations

from typing import Annotated

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.errors import per_frame
from kinema.diffusion.flow import Flow
from kinema.generators.frames.generator import FrameDiffusion
from kinema.generators.frames.sampling import FrameSampling
from kinema.generators.motiondiffuse.denoiser import MotionDiffuseDenoiser
from kinema.nn.stylization import ATTENTIONS
from kinema.options import Depth, OneOf, OpenShare, OptionalDepth, Share, Size, checked
from kinema.registry import buildable


@buildable
class MotionDiffuse(FrameDiffusion):
    """Diffuse frames by `MotionDiffuseDenoiser`: the loss counts all frames alike, no text is dropped, none guides.

    `attention`, the text's transformer and sizes as in `MotionDiffuseDenoiser`. As published `condition_drop` is 0.
    """

    denoiser: MotionDiffuseDenoiser

    @checked
    def __init__(
        self,
        *,
        frame_dim: Size,
        token_dim: Size,
        process: DDPM | Flow,
        width: Size = 512,
        feedforward: Size = 1024,
        layers: Depth = 8,
        heads: Size = 8,
        text_width: Size = 256,
        text_feedforward: Size = 2048,
        text_layers: OptionalDepth = 4,
        text_heads: Size = 4,
        dropout: OpenShare = 0.0,
        attention: Annotated[str, OneOf(ATTENTIONS)] = "linear",
        condition_drop: Share = 0.0,
        max_frames: Size = 196,
        sampling: FrameSampling | None = None,
    ) -> None:
        denoiser = MotionDiffuseDenoiser(
            frame_dim,
            token_dim=token_dim,
            max_frames=max_frames,
            width=width,
            feedforward=feedforward,
            layers=layers,
            heads=heads,
            text_width=text_width,
            text_feedforward=text_feedforward,
            text_layers=text_layers,
            text_heads=text_heads,
            dropout=dropout,
            attention=attention,
        )
        super().__init__(
            denoiser,
            process,
            frame_dim=frame_dim,
            max_frames=max_frames,
            condition_drop=condition_drop,
            mask_frames=True,
            average=per_frame,
            sampling=sampling or FrameSampling(),
        )
        self.token_dim = token_dim
