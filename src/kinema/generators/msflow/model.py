"""Generate motion as MSFlow does: a flow on frames, without an autoencoder, under the words of a text (FRONTIER §2)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Annotated

from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.errors import per_sequence
from kinema.diffusion.flow import Flow
from kinema.generators import TrainingLatents
from kinema.generators.frames.generator import SequenceDiffusion
from kinema.generators.frames.sampling import DiffusionSampling, FrameSampling
from kinema.generators.frames.training import FrameDraws
from kinema.generators.msflow.denoiser import TEXT_ATTENTION, MsflowDenoiser
from kinema.generators.msflow.masks import MASKS
from kinema.generators.msflow.physics import Physics
from kinema.generators.msflow.shortcut import Shortcut, ShortcutSampling
from kinema.generators.texts import without_text, without_words
from kinema.options import Depth, OneOf, OptionalDepth, Share, Size, checked
from kinema.registry import buildable
from kinema.tokenizers import MotionTokenizer
from kinema.types import LatentSpace, TextFeatures

SHORTCUT = "shortcut"


@buildable
class MSFlow(SequenceDiffusion):
    """Flow in motion space (FRONTIER §2): XYZ, all or the essential dims, as the tokenizer gives them.

    With a `unit` of more than one frame it is a flow on a tokenizer's continuous latents, `frame_dim` channels each.

    `process` is a `Flow`, published with prediction "x1" and source_scale 5. The other options are those of
    `MsflowDenoiser`. Without `null_tokens` a dropped text has zeros in place of its words' features, so that its length
    is still seen, as published. `physics` weighs penalties on the predicted clean motion, the more the nearer it is to
    the data; published are none.
    """

    parts = (SHORTCUT,)
    denoiser: MsflowDenoiser
    place: Callable[[Tensor], Tensor] | None = None
    _shortcut: tuple[Shortcut, ...] = ()  # a tuple: no submodule, so neither saved nor trained here

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
        batch_multiplier: Size = 1,
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
            batch_multiplier=batch_multiplier,
            sampling=sampling or FrameSampling(guidance=3.0, solver="heun", solver_steps=49),
        )
        self.token_dim = token_dim

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

    @property
    def networks(self) -> dict[str, nn.Module]:
        """The network that samples: the shortcut's, where one is attached."""
        return {"denoiser": self._shortcut[0].denoiser} if self._shortcut else super().networks

    def attach(self, part: str, module: nn.Module) -> None:
        """Take a shortcut, and sample by it from then on; raises ValueError for that of another generator."""
        if part != SHORTCUT:
            super().attach(part, module)
        if not isinstance(module, Shortcut):
            raise ValueError(f"a {type(module).__name__} is no shortcut; give the run of a shortcut stage")
        module.check_generator(self)
        self._shortcut, self.sampling = (module,), module.sampling

    def check_sampling(self, sampling: DiffusionSampling | ShortcutSampling) -> None:
        """Refuse a number of steps that an attached shortcut hasn't learnt, too."""
        if isinstance(sampling, ShortcutSampling):
            return self.shortcut.check_sampling(sampling)
        return super().check_sampling(sampling)

    @property
    def shortcut(self) -> Shortcut:
        """The attached shortcut; raises ValueError without one."""
        if not self._shortcut:
            raise ValueError(
                "ShortcutSampling asks for a shortcut network, and this model has none; give the run of its shortcut "
                "stage (from_run(..., shortcut=RUN)), or attach one"
            )
        return self._shortcut[0]

    def solved(
        self,
        text: TextFeatures,
        noise: Iterator[Float[Tensor, "b n c"]],
        *,
        shown: Bool[Tensor, "b n"] | None,
        seeds: Int[Tensor, " b"],
        known: tuple[Float[Tensor, "b n c"], Bool[Tensor, "b n c"]] | None,
        sampling: DiffusionSampling | ShortcutSampling,
    ) -> Float[Tensor, "b n c"]:
        """Take noise to motion by the flow, or by its shortcut where that is asked for."""
        if isinstance(sampling, ShortcutSampling):
            return self.shortcut.few_steps(text, noise, shown=shown, known=known, sampling=sampling)
        return super().solved(text, noise, shown=shown, seeds=seeds, known=known, sampling=sampling)

    def without_text(self, text: TextFeatures, drop: Bool[Tensor, " b"] | None = None) -> TextFeatures:
        """Hide the words of the samples in `drop` (None: of all) behind the null tokens, or zero their features."""
        return without_text(text, drop) if self.denoiser.words.null is None else without_words(text, drop)
