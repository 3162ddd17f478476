"""Generate frames as ReMoDiffuse does: under the text, and motions whose captions and lengths are near it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, cast

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.errors import per_frame
from kinema.diffusion.flow import Flow
from kinema.diffusion.guidance import Predict
from kinema.generators.frames.generator import FrameDiffusion
from kinema.generators.frames.sampling import DiffusionSampling
from kinema.generators.frames.training import FrameDraws
from kinema.generators.remodiffuse.database import RetrievalDatabase, best
from kinema.generators.remodiffuse.denoiser import ReMoDiffuseDenoiser
from kinema.generators.remodiffuse.encoder import Retrieved
from kinema.generators.remodiffuse.mixture import PASSES, MixtureSampling, flip
from kinema.options import Depth, NonNegative, OneOf, OpenShare, OptionalDepth, Share, Size, checked
from kinema.registry import buildable
from kinema.types import TextFeatures

RETRIEVAL = "retrieval"
EXCLUSIONS = ("same_id", "legacy_length")


@dataclass
class RetrievalDraws(FrameDraws):
    """Hold what a step draws, and beside the dropped texts the samples that see nothing retrieved."""

    retrieval_drop: Bool[Tensor, " b"]

    @classmethod
    def draw(
        cls,
        shape: tuple[int, int, int],
        process: DDPM | Flow,
        *,
        condition_drop: float,
        generator: torch.Generator | None,
        device: torch.device,
    ) -> RetrievalDraws:
        """Draw for `shape` = (samples, frames, features); text and retrieval are dropped independently."""
        options: dict[str, Any] = {"generator": generator, "device": device}
        common = FrameDraws.draw(shape, process, condition_drop=condition_drop, **options)
        return cls(**vars(common), retrieval_drop=torch.rand(shape[0], **options) < condition_drop)


@buildable
class ReMoDiffuse(FrameDiffusion):
    """Diffuse frames by `ReMoDiffuseDenoiser`, with a `RetrievalDatabase` attached in training and in sampling.

    The `neighbours` nearest captions of the database are read, by cosine and length (`length_weight`). In training
    `exclusion` leaves out those of the sample's own clip, its parts and mirror image ("same_id"), or of motions of
    exactly its length, which rarely is more than a part of these and others too ("legacy_length", as published). Text
    and retrieval are dropped with probability `condition_drop` each. Other sizes as in `ReMoDiffuseDenoiser`.
    """

    parts = (RETRIEVAL,)
    draws_type = RetrievalDraws
    denoiser: ReMoDiffuseDenoiser

    @checked
    def __init__(
        self,
        *,
        frame_dim: Size,
        token_dim: Size,
        process: DDPM,
        width: Size = 512,
        feedforward: Size = 1024,
        layers: Depth = 4,
        heads: Size = 8,
        embedding: Size | None = None,
        text_width: Size = 256,
        text_feedforward: Size = 2048,
        text_layers: OptionalDepth = 2,
        text_heads: Size = 4,
        retrieval_layers: Depth = 2,
        retrieval_text_layers: OptionalDepth = 2,
        retrieved_dim: Size | None = None,
        stride: Size = 4,
        dropout: OpenShare = 0.0,
        neighbours: Size = 2,
        length_weight: NonNegative = 0.1,
        exclusion: Annotated[str, OneOf(EXCLUSIONS)] = "same_id",
        condition_drop: Share = 0.1,
        max_frames: Size = 196,
        sampling: MixtureSampling | None = None,
    ) -> None:
        denoiser = ReMoDiffuseDenoiser(
            frame_dim,
            token_dim=token_dim,
            max_frames=max_frames,
            width=width,
            feedforward=feedforward,
            layers=layers,
            heads=heads,
            embedding=embedding,
            text_width=text_width,
            text_feedforward=text_feedforward,
            text_layers=text_layers,
            text_heads=text_heads,
            retrieval_layers=retrieval_layers,
            retrieval_text_layers=retrieval_text_layers,
            retrieved_dim=retrieved_dim,
            stride=stride,
            dropout=dropout,
        )
        super().__init__(
            denoiser,
            process,
            frame_dim=frame_dim,
            max_frames=max_frames,
            condition_drop=condition_drop,
            mask_frames=True,
            average=per_frame,
            sampling=sampling or MixtureSampling(),
        )
        self.token_dim = token_dim
        self.steps = len(process.schedule.betas)
        self.retrieved_dim, self.neighbours = retrieved_dim or token_dim, neighbours
        self.length_weight, self.exclusion = length_weight, exclusion
        self._database: tuple[RetrievalDatabase, ...] = ()  # a tuple: no submodule, so neither saved nor trained here

    def attach(self, part: str, module: nn.Module) -> None:
        """Take a database; raises ValueError for one of other frames or texts, or with too few captions."""
        if part != RETRIEVAL:
            super().attach(part, module)
        if not isinstance(module, RetrievalDatabase):
            raise ValueError(f"a {type(module).__name__} is no retrieval database; give the run of a retrieval stage")
        for what, own, theirs in (
            ("frames", self.width, module.frame_dim),
            ("token features", self.retrieved_dim, module.token_dim),
        ):
            if own != theirs:
                raise ValueError(
                    f"the database holds {what} of {theirs} numbers, this model reads {own}; build it with the model's "
                    "representation and text encoder"
                )
        if len(module.captions) < self.neighbours:
            raise ValueError(
                f"the database holds {len(module.captions)} captions, fewer than the {self.neighbours} neighbours that "
                "are retrieved; build it of a larger corpus"
            )
        self._database = (module,)

    @property
    def database(self) -> RetrievalDatabase:
        """The attached database; raises ValueError without one."""
        if not self._database:
            raise ValueError(
                "this model retrieves from a database and has none; give the run of its retrieval stage "
                "(from_run(..., retrieval=RUN)), or attach one"
            )
        return self._database[0]

    def retrieve(self, text: TextFeatures, lengths: Int[Tensor, " b"]) -> Retrieved:
        """Read the neighbours of texts and lengths; in training without those that `exclusion` leaves out."""
        database = self.database
        with torch.no_grad():
            scores = database.scores(text.pooled, lengths, length_weight=self.length_weight)
            excluded = self._excluded(text, lengths) if self.training else None
            neighbours = database.gather(best(scores, self.neighbours, excluded))
        return self.denoiser.retrieval(neighbours)

    def errors(
        self, x1: Float[Tensor, "b n c"], text: TextFeatures, draws: FrameDraws, real: Bool[Tensor, "b n"]
    ) -> Float[Tensor, "b n c"]:
        """Return the squared error of every feature of every frame."""
        draws = cast(RetrievalDraws, draws)
        words, seen = self._read(text)
        seen = seen & ~draws.condition_drop[:, None]
        rows = torch.arange(len(x1), device=x1.device)
        retrieved = self.retrieve(text, real.sum(dim=1)).rows(rows, ~draws.retrieval_drop)
        return self.process.errors(
            lambda x, time: self.denoiser(x, time, words, seen, real, retrieved), x1, draws.time, draws.noise
        )

    def mixed(
        self,
        x: Float[Tensor, "b t d"],
        time: Tensor,
        words: Float[Tensor, "b l w"],
        seen: Bool[Tensor, "b l"],
        real: Bool[Tensor, "b t"],
        retrieved: Retrieved,
        weights: Float[Tensor, "b 4"],
    ) -> Float[Tensor, "b t d"]:
        """Weigh the passes' predictions, all in one batch; passes without a weight are left out."""
        count = int((weights != 0).sum(dim=1).max())
        passes = (weights == 0).to(torch.uint8).argsort(dim=1, stable=True)[:, :count]
        rows = torch.arange(len(x), device=x.device).repeat_interleave(count)
        with_text, with_retrieval = torch.tensor(PASSES, device=x.device)[passes.flatten()].unbind(1)
        predicted = self.denoiser(
            x[rows],
            time,
            words[rows],
            seen[rows] & with_text[:, None],
            real[rows],
            retrieved.rows(rows, with_retrieval),
        )
        scale = weights.gather(1, passes).to(predicted.dtype)
        return (predicted.unflatten(0, (len(x), count)) * scale[..., None, None]).sum(dim=1)

    def _predictor(
        self,
        text: TextFeatures,
        shown: Bool[Tensor, "b n"] | None,
        sampling: DiffusionSampling,
        seeds: Int[Tensor, " b"],
    ) -> Predict:
        """Close over what all steps share: the text and the neighbours, of which the text and the length alone tell."""
        real, options = cast(Tensor, shown), cast(MixtureSampling, sampling)
        words, seen = self._read(text)
        retrieved = self.retrieve(text, real.sum(dim=1))

        def predict(x: Tensor, time: Tensor) -> Tensor:
            weights = options.mixture(time.item() / self.steps, flip(seeds, int(time.item()))).to(x)
            return self.mixed(x, time, words, seen, real, retrieved, weights)

        return predict

    def _read(self, text: TextFeatures) -> tuple[Float[Tensor, "b l w"], Bool[Tensor, "b l"]]:
        words, seen = self.denoiser.read(text)
        return words, words.new_ones(words.shape[:2], dtype=torch.bool) if seen is None else seen

    def _excluded(self, text: TextFeatures, lengths: Int[Tensor, " b"]) -> Bool[Tensor, "b n"]:
        if self.exclusion == "legacy_length":
            return self.database.same_length(lengths)
        if len(text.clip_ids) != len(lengths):
            raise ValueError(
                f"{len(text.clip_ids)} clip ids for {len(lengths)} samples: without them a clip would retrieve itself; "
                "set text.clip_ids, or train with exclusion=legacy_length"
            )
        return self.database.same_clip(text.clip_ids)
