"""Generate motion as MSFlow does: a flow on frames, without an autoencoder, under the words of a text (FRONTIER §2)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

from jaxtyping import Bool, Float
from torch import Tensor

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.errors import per_sequence
from kinema.diffusion.flow import Flow
from kinema.generators import TrainingLatents
from kinema.generators.frames.generator import SequenceDiffusion
from kinema.generators.frames.sampling import FrameSampling
from kinema.generators.frames.training import FrameDraws
from kinema.generators.msflow.denoiser import TEXT_ATTENTION, MsflowDenoiser
from kinema.generators.msflow.masks import MASKS
from kinema.generators.msflow.physics import Physics
from kinema.generators.texts import without_text, without_words
from kinema.options import Depth, OneOf, OptionalDepth, Share, Size, checked
from kinema.registry import buildable
from kinema.tokenizers import MotionTokenizer
from kinema.types import LatentSpace, TextFeatures


@buildable
class MSFlow(SequenceDiffusion):
    """Flow in motion space (FRONTIER §2): XYZ, all or the essential dims, as the tokenizer gives them.

    With a `unit` of more than one frame it is a flow on a tokenizer's continuous latents, `frame_dim` channels each.

    `process` is a `Flow`, published with prediction "x1" and source_scale 5. The other options are those of
    `MsflowDenoiser`. Without `null_tokens` a dropped text has zeros in place of its words' features, so that its length
    is still seen, as published. `physics` weighs penalties on the predicted clean motion, the more the nearer it is to
    the data; published are none.
    """

    denoiser: MsflowDenoiser
    place: Callable[[Tensor], Tensor] | None = None

    @checked
    def __init__(
        self,
        *,
        frame_dim: Size,
        process: DDPM | Flow,
        token_dim: Size,
        unit: Size = 1,
        width: Size = 512,
        feedforward: Size = 1024,
        layers: Depth = 8,
        heads: Size = 4,
        patch: Size = 1,
        mask: Annotated[str, OneOf(MASKS)] = "bidirectional",
        mask_block: Size = 1,
        text_attention: Annotated[str, OneOf(TEXT_ATTENTION)] = "joint",
        refiner_layers: OptionalDepth = 2,
        refiner_timed: bool = True,
        null_tokens: OptionalDepth = 0,
        shared_modulation: bool = False,
        physics: Physics | None = None,
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
            refiner_timed=refiner_timed,
            null_tokens=null_tokens,
            shared_modulation=shared_modulation,
        )
        super().__init__(
            denoiser,
            process,
            space=LatentSpace("frames" if unit == 1 else "continuous", frame_dim, max_frames // unit, unit),
            condition_drop=condition_drop,
            mask_frames=True,
            average=per_sequence,
            sampling=sampling or FrameSampling(guidance=3.0, solver="heun", solver_steps=49),
        )

        if physics is not None and physics.used and not (isinstance(process, Flow) and process.prediction == "x1"):
            raise ValueError(
                "physics reads the predicted clean motion; use a Flow with prediction x1, or physics: null"
            )
        self.physics = physics if physics is not None and physics.used else None

    def prepare(self, tokenizer: MotionTokenizer, latents: TrainingLatents) -> None:
        """Take how frames become joints, where penalties read these."""
        if self.physics is not None:
            self.place, self.skeleton = tokenizer.joints, tokenizer.representation.skeleton

    def errors(
        self, x1: Float[Tensor, "b n c"], text: TextFeatures, draws: FrameDraws, real: Bool[Tensor, "b n"]
    ) -> Float[Tensor, "b n c"]:
        """Return the squared error of every feature, and in each the penalties of its frame."""
        if self.physics is None:
            return super().errors(x1, text, draws, real)
        if self.place is None:
            raise ValueError("physics needs the tokenizer's joints; call prepare(tokenizer, latents) before training")
        condition, seen = self.denoiser.read(self.without_text(text, draws.condition_drop))
        clean: list[Tensor] = []

        def predict(x: Tensor, time: Tensor) -> Tensor:
            clean.append(self.denoiser(x, time, condition, seen, real))
            return clean[-1]

        errors = self.process.errors(predict, x1, draws.time, draws.noise)
        penalties = self.physics.penalties(self.place(clean[0]), self.place(x1), real, self.skeleton)
        return errors + (draws.time[:, None].square() * penalties)[..., None]

    def without_text(self, text: TextFeatures, drop: Bool[Tensor, " b"] | None = None) -> TextFeatures:
        """Hide the words of the samples in `drop` (None: of all) behind the null tokens, or zero their features."""
        return without_text(text, drop) if self.denoiser.words.null is None else without_words(text, drop)
