"""Generate frames as MDM does: a transformer denoises the whole motion at once (MDM §2-§5)."""

from __future__ import annotations

from typing import Annotated

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.errors import per_sequence
from kinema.diffusion.flow import Flow
from kinema.generators.frames.generator import FrameDiffusion
from kinema.generators.frames.sampling import FrameSampling
from kinema.generators.mdm.denoiser import ARCHITECTURES, MdmDenoiser
from kinema.options import Depth, OneOf, OpenShare, Share, Size, checked
from kinema.registry import buildable


@buildable
class MDM(FrameDiffusion):
    """Motion diffusion model (MDM §2-§5); `process` says in how many steps, and whether it predicts x0 or noise.

    `mask_frames` is on for the published 50 steps, off for the paper's 1000. `text_dim` or `token_dim`, and
    `architecture`, as in `MdmDenoiser`.
    """

    denoiser: MdmDenoiser

    @checked
    def __init__(
        self,
        *,
        frame_dim: Size,
        process: DDPM | Flow,
        text_dim: Size | None = None,
        token_dim: Size | None = None,
        width: Size = 512,
        feedforward: Size = 1024,
        layers: Depth = 8,
        heads: Size = 4,
        dropout: OpenShare = 0.1,
        architecture: Annotated[str, OneOf(ARCHITECTURES)] = "encoder",
        condition_drop: Share = 0.1,
        mask_frames: bool = True,
        max_frames: Size = 196,
        sampling: FrameSampling | None = None,
    ) -> None:
        denoiser = MdmDenoiser(
            frame_dim,
            text_dim=text_dim,
            token_dim=token_dim,
            width=width,
            feedforward=feedforward,
            layers=layers,
            heads=heads,
            dropout=dropout,
            architecture=architecture,
        )
        super().__init__(
            denoiser,
            process,
            frame_dim=frame_dim,
            max_frames=max_frames,
            condition_drop=condition_drop,
            mask_frames=mask_frames,
            average=per_sequence,
            sampling=sampling or FrameSampling(guidance=2.5),
        )
        self.text_dim, self.token_dim = text_dim, token_dim
