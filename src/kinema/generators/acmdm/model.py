"""Generate motion as ACMDM does: a flow on absolute joints or their latents, as a whole (FRONTIER §3)."""

from __future__ import annotations

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.errors import per_sequence
from kinema.diffusion.flow import Flow
from kinema.generators.acmdm.denoiser import AcmdmDenoiser
from kinema.generators.frames.generator import SequenceDiffusion
from kinema.generators.frames.sampling import FrameSampling
from kinema.options import Depth, Share, Size, checked
from kinema.registry import buildable
from kinema.types import LatentSpace


@buildable
class ACMDM(SequenceDiffusion):
    """Absolute-coordinate motion diffusion (FRONTIER §3): `channels` numbers for each joint and latent frame.

    `unit` is the frames of a latent; 1: frames of joints as they are. `patch` joints make a token. `process` is a
    `Flow` of velocities from standard noise, as published.
    """

    denoiser: AcmdmDenoiser

    @checked
    def __init__(
        self,
        *,
        joints: Size,
        channels: Size,
        unit: Size,
        text_dim: Size,
        process: DDPM | Flow,
        patch: Size,
        width: Size = 512,
        layers: Depth = 8,
        heads: Size = 8,
        condition_drop: Share = 0.1,
        max_frames: Size = 196,
        sampling: FrameSampling | None = None,
    ) -> None:
        most = max_frames // unit
        denoiser = AcmdmDenoiser(
            joints=joints,
            channels=channels,
            patch=patch,
            most=most,
            text_dim=text_dim,
            width=width,
            layers=layers,
            heads=heads,
        )
        super().__init__(
            denoiser,
            process,
            space=LatentSpace("frames" if unit == 1 else "continuous", joints * channels, most, unit),
            condition_drop=condition_drop,
            mask_frames=True,
            average=per_sequence,
            sampling=sampling or FrameSampling(guidance=3.0),
        )
        self.text_dim = text_dim
