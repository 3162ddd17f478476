"""Sample a trained flow in a few large steps, by a network that knows how large its steps are (FRONTIER §8, §9.8)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, cast

import torch
from annotated_types import Len
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from kinema.diffusion.choices import Holding, SolverGrid
from kinema.diffusion.errors import per_sequence
from kinema.diffusion.flow import Flow
from kinema.diffusion.grids import GRIDS, nested
from kinema.diffusion.guidance import Predict
from kinema.diffusion.shortcut import SOLVERS, aimed, followed
from kinema.generators import LatentModel
from kinema.generators.draws import StepDraws, share_of
from kinema.generators.frames.generator import SequenceDiffusion
from kinema.generators.msflow.denoiser import MsflowDenoiser
from kinema.generators.texts import beside, check_guidance, some
from kinema.generators.values import check_latents
from kinema.nn.ranks import mean_over_ranks
from kinema.options import NonNegative, OneOf, Options, Share, Steps, checked
from kinema.registry import buildable
from kinema.types import Latents, LatentSpace, Losses, TextFeatures, frame_mask

MOST_STEPS = Literal[2, 4, 8, 16, 32]


@buildable
@dataclass(frozen=True)
class ShortcutSampling(Options):
    """Choose in how many steps a shortcut network samples, each one evaluation; its guidance is baked in.

    An edit is held as `FrameSampling` says.
    """

    steps: Steps = 4
    holding: Holding = "path"
    renewal: Share | None = None


@dataclass
class ShortcutDraws(StepDraws):
    """Hold what a step draws: whom the teacher teaches, the level that each learns, an interval each, and noise."""

    taught: Bool[Tensor, " b"]
    level: Float[Tensor, " b"]
    interval: Float[Tensor, " b"]
    noise: Float[Tensor, "b n c"]

    @classmethod
    def draw(
        cls,
        shape: tuple[int, int, int],
        *,
        teacher_share: float,
        generator: torch.Generator | None,
        device: torch.device,
    ) -> ShortcutDraws:
        """Draw for `shape` = (samples, frames, features)."""
        taught, level, interval = torch.rand(3, shape[0], generator=generator, device=device)
        noise = torch.randn(shape, generator=generator, device=device)
        return cls(taught=taught < teacher_share, level=level, interval=interval, noise=noise)


@buildable
class Shortcut(LatentModel):
    """Predict the clean motion by which one Euler step ends where a guided flow gets in many (shortcut models).

    A copy of a trained MSFlow with one more input, the level: how many steps the whole way has, `finest` or a half, a
    quarter, ... of it, down to one. A level's times are every second one of the next finer level's, so that a step is
    two of its. The levels of `counts` steps are learnt (None: all of them). A step learns where the frozen teacher gets
    under `guidance`, by `substeps` of its `solver` in each of the finest steps of its span. With a `teacher_share`
    below 1 the others learn, but for the finest level, where two of the network's own steps of the next finer level
    get, as published: cheaper, but it may chase itself and diverge.

    The loss is the squared error of the clean motion, unweighted. Of a step from signal over noise r to r', an error e
    moves what the state says of the motion, x / t, by (1 - r / r') e: by as much on every interval of the grid
    "emergence". A flow's weight 1 / (1 - t)^2 would make the last one nearly all of the loss.
    """

    @checked
    def __init__(
        self,
        *,
        generator: SequenceDiffusion,
        finest: MOST_STEPS = 8,
        counts: Annotated[Sequence[Steps], Len(1)] | None = None,
        grid: SolverGrid = "emergence",
        guidance: NonNegative = 3.0,
        teacher_share: Share = 1.0,
        substeps: Steps = 2,
        solver: Annotated[str, OneOf(SOLVERS)] = "euler",
        sampling: ShortcutSampling | None = None,
    ) -> None:
        super().__init__()
        self.token_dim = generator.token_dim
        process, denoiser = generator.process, generator.denoiser
        if not isinstance(denoiser, MsflowDenoiser) or not isinstance(process, Flow) or process.prediction != "x1":
            raise ValueError(
                "a shortcut steps by the clean motion that a MSFlow predicts; its generator's process must be a Flow "
                "with prediction x1"
            )
        check_guidance(generator.condition_drop, guidance=guidance)
        self.generator = generator
        self.finest, self.times = finest, GRIDS[grid](finest, process.source_scale)
        self.guidance, self.teacher_share = guidance, teacher_share
        self.substeps, self.solver = substeps, solver
        self.level = nn.Embedding(finest.bit_length(), denoiser.width)
        nn.init.zeros_(self.level.weight)
        self.learnt = tuple(map(self.level_of, counts)) if counts is not None else tuple(range(finest.bit_length()))
        if teacher_share < 1 and sorted(self.learnt) != list(range(max(self.learnt) + 1)):
            raise ValueError(
                f"counts={list(counts or ())}: with teacher_share={teacher_share} a step learns from two of the next "
                f"finer level, so they must be {finest} and all halves of it down to the least; or use teacher_share=1"
            )
        self._teacher: tuple[SequenceDiffusion, ...] = ()  # a tuple: no submodule, so neither saved nor trained here
        self.sampling = sampling or ShortcutSampling(steps=finest >> self.learnt[0])
        self.check_sampling(self.sampling)

    @property
    def space(self) -> LatentSpace:  # type: ignore[override]
        """Those of the generator."""
        return self.generator.space

    @property
    def denoiser(self) -> MsflowDenoiser:
        """The network."""
        return cast(MsflowDenoiser, self.generator.denoiser)

    @property
    def process(self) -> Flow:
        """The flow that is stepped along."""
        return cast(Flow, self.generator.process)

    @property
    def teacher(self) -> SequenceDiffusion:
        """The trained generator; raises ValueError where none was given."""
        if not self._teacher:
            raise ValueError("a shortcut learns from a trained generator and has none; call learn_from(generator)")
        return self._teacher[0]

    def check_sampling(self, sampling: ShortcutSampling) -> None:
        """Raise ValueError for a number of steps that was not learnt."""
        if self.level_of(sampling.steps) not in self.learnt:
            counts = ", ".join(str(self.finest >> level) for level in self.learnt)
            raise ValueError(
                f"steps={sampling.steps}: this shortcut learns {counts}; sample in as many, or tune another with "
                f"counts=[{sampling.steps}]"
            )

    def level_of(self, steps: int) -> int:
        """Say on which level the whole way has so many steps; raises ValueError where none has."""
        nested(self.times, steps)
        return (self.finest // steps).bit_length() - 1

    def check_generator(self, generator: SequenceDiffusion) -> None:
        """Raise ValueError for a generator of another size or flow than the one that this network starts from."""
        own, other = ({name: tuple(x.shape) for name, x in g.state_dict().items()} for g in (self.generator, generator))
        process, scale = generator.process, self.process.source_scale
        if not isinstance(process, Flow) or (process.prediction, process.source_scale) != ("x1", scale):
            raise ValueError(
                f"the shortcut steps along a Flow of prediction x1 and source_scale {scale}, the generator's is "
                "another; train the shortcut on this generator"
            )
        if unlike := sorted(name for name in own.keys() | other.keys() if own.get(name) != other.get(name)):
            name = unlike[0]
            theirs, ours = other.get(name, "absent"), own.get(name, "absent")
            raise ValueError(
                f"{name} is {theirs} in the generator and {ours} in its shortcut; train the shortcut on this generator"
            )

    def learn_from(self, generator: SequenceDiffusion) -> None:
        """Take the trained generator: as the teacher, and the weights to start from."""
        self.check_generator(generator)
        self.generator.load_state_dict(generator.state_dict())
        self._teacher = (generator.eval().requires_grad_(False),)

    def predictor(self, text: TextFeatures, level: Int[Tensor, " m"], real: Bool[Tensor, "b n"] | None) -> Predict:
        """Close over the texts, which are read once, and one level for all rows or one per row."""
        condition, seen = self.denoiser.read(text)
        return lambda x, time: self.denoiser(x, time, condition, seen, real, self.level(level))

    def taught(self, text: TextFeatures, real: Bool[Tensor, "b n"]) -> Predict:
        """Close over the texts for the teacher, guided, at one time per row."""
        teacher = self.teacher
        if self.guidance == 1:
            condition, seen = teacher.denoiser.read(text)
            return lambda x, time: teacher.denoiser(x, time, condition, seen, real)
        condition, seen = teacher.denoiser.read(beside(text, teacher.without_text(text)))

        def guided(x: Tensor, time: Tensor) -> Tensor:
            twice = teacher.denoiser(torch.cat((x, x)), time.repeat(2), condition, seen, real.repeat(2, 1))
            given, empty = twice.chunk(2)
            return empty + self.guidance * (given - empty)

        return guided

    def loss(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
        draws: ShortcutDraws | None = None,
    ) -> Losses:
        """Return the squared error of the clean motion, averaged over features, real frames and samples.

        Draws are made for the global batch, from `generator` (None: torch's own), of which this batch is the part
        `shard` = (rank, world). `draws` replaces what is drawn (tests).
        """
        x1 = check_latents(latents, self.space).detach() * latents.mask[..., None]
        real = frame_mask(latents.lengths, x1.shape[1])
        draws = draws or self._draw(x1, generator, shard)
        level, first, last = self._intervals(draws)
        start, end = (x1.new_tensor(self.times)[place] for place in (first, last))
        x = self.process.add_noise(x1, start, draws.noise)
        reached = self.reached(x, text, level, first, last, draws.taught, real)
        errors = (self.predictor(text, level, real)(x, start) - aimed(x, reached, start, end)).square()
        return {"loss": mean_over_ranks(per_sequence(errors, real), shard[1])}

    @torch.no_grad()
    def reached(
        self,
        x: Float[Tensor, "b n c"],
        text: TextFeatures,
        level: Int[Tensor, " b"],
        first: Int[Tensor, " b"],
        last: Int[Tensor, " b"],
        taught: Bool[Tensor, " b"],
        real: Bool[Tensor, "b n"],
    ) -> Float[Tensor, "b n c"]:
        """Say where steps between times of the grid ought to end: on the teacher's way, or after two steps."""
        times, found, own = x.new_tensor(self.times), x, taught | (level == 0)
        for k in range(int((last - first)[own].max()) if own.any() else 0):
            on = own & (first + k < last)
            predict = self.taught(some(text, on), real[on])
            start, end = times[first[on] + k], times[first[on] + k + 1]
            reached = followed(predict, found[on], start, end, substeps=self.substeps, solver=self.solver)
            found = found.masked_scatter(on[:, None, None].expand_as(found), reached)
        if not own.all():
            halved = ~own
            found = found.clone()
            predict = self.predictor(some(text, halved), level[halved] - 1, real[halved])
            middle = (first + last)[halved] // 2
            half = followed(predict, x[halved], times[first[halved]], times[middle])
            found[halved] = followed(predict, half, times[middle], times[last[halved]])
        return found

    def _intervals(self, draws: ShortcutDraws) -> tuple[Int[Tensor, " b"], Int[Tensor, " b"], Int[Tensor, " b"]]:
        """Return each sample's level (0: the finest) and where on the finest grid its step starts and ends."""
        learnt = torch.tensor(self.learnt, device=draws.level.device)
        level = learnt[(draws.level * len(learnt)).long().clamp(max=len(learnt) - 1)]
        size = 2**level
        steps = self.finest // size
        first = (draws.interval * steps).long().clamp(max=steps - 1) * size
        return level, first, first + size

    def _draw(
        self, x1: Float[Tensor, "b n c"], generator: torch.Generator | None, shard: tuple[int, int]
    ) -> ShortcutDraws:
        batch, frames, features = x1.shape
        return share_of(
            lambda samples: ShortcutDraws.draw(
                (samples, self.space.most, features),
                teacher_share=self.teacher_share,
                generator=generator,
                device=x1.device,
            ),
            batch,
            shard,
            frames,
        )

    def few_steps(
        self,
        text: TextFeatures,
        noise: Iterator[Float[Tensor, "b n c"]],
        *,
        shown: Bool[Tensor, "b n"] | None,
        known: tuple[Float[Tensor, "b n c"], Bool[Tensor, "b n c"]] | None,
        sampling: ShortcutSampling,
    ) -> Float[Tensor, "b n c"]:
        """Take noise to motion in a few steps; what is `known` (values, mask) is held on the way."""
        times = nested(self.times, sampling.steps)
        level = torch.tensor([self.level_of(sampling.steps)], device=self.level.weight.device)
        return self.process.sample(
            self.predictor(text, level, shown),
            noise,
            solver="euler",
            times=times,
            known=known,
            holding=sampling.holding,
            renewal=sampling.renewal,
        )
