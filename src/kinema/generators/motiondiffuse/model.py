"""Generate frames as MotionDiffuse does: stylised attention to frames and words predicts the noise (MotionDiffuse)."""

from __future__ import annotations

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.errors import per_frame
from kinema.diffusion.flow import Flow
from kinema.generators.frames.generator import FrameDiffusion
from kinema.generators.frames.sampling import FrameSampling
from kinema.generators.motiondiffuse.denoiser import MotionDiffuseDenoiser
from kinema.registry import buildable


@buildable
class MotionDiffuse(FrameDiffusion):
    """Diffuse frames by `MotionDiffuseDenoiser`: the loss counts all frames alike, no text is dropped, none guides.

    `attention`, the text's transformer and sizes as in `MotionDiffuseDenoiser`. As published `condition_drop` is 0.
    """

    denoiser: MotionDiffuseDenoiser

    def __init__(
        self,
        *,
        frame_dim: int,
        token_dim: int,
        process: DDPM | Flow,
        width: int = 512,
        feedforward: int = 1024,
        layers: int = 8,
        heads: int = 8,
        text_width: int = 256,
        text_feedforward: int = 2048,
        text_layers: int = 4,
        text_heads: int = 4,
        dropout: float = 0.0,
        attention: str = "linear",
        condition_drop: float = 0.0,
        max_frames: int = 196,
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
