"""Mix the predictions under text and retrieval, one of them or none, by the time (ReMoDiffuse §5)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.diffusion.choices import Solver, SolverSteps
from kinema.generators.frames.sampling import FrameSampling
from kinema.registry import buildable
from kinema.seeds import item_seed

PASSES = ((True, True), (True, False), (False, True), (False, False))
"""Whether each pass sees the text and what was retrieved, in the order of the weights."""
FINE = 0.1
"""The share of the noisy end's time below which the weights are constant."""


@buildable
@dataclass(frozen=True)
class MixtureSampling(FrameSampling):
    """Choose how frames are sampled and what the four passes weigh.

    At the share s > 0.1 of the way from data to noise, w = 1 + `coarse` s stands before the pass with the text, 1 - w
    before the one without, both with retrieval or both without: a coin decides at each step. Below, the weights are
    `both`, `text` and `retrieval`, and that of the empty pass makes the sum 1. The defaults are HumanML3D's; `guidance`
    has no part in it.
    """

    solver: Solver | None = "ddim"
    solver_steps: SolverSteps | None = "15,15,8,6,6"
    coarse: float = 6.5
    both: float = 0.52351
    text: float = -0.28419
    retrieval: float = 2.39872

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.guidance != 1:
            raise ValueError(
                f"sampling.guidance is {self.guidance}, but ReMoDiffuse mixes four passes instead; leave it at 1 and "
                "set sampling.coarse, both, text and retrieval"
            )
        usual = {one.name: one.default for one in fields(FrameSampling)}
        for name in ("guidance_interval", "guidance_growing", "holding", "renewal"):
            if getattr(self, name) != usual[name]:
                raise ValueError(
                    f"sampling.{name} is {getattr(self, name)}, which ReMoDiffuse's mixture doesn't read; leave it out"
                )

    def mixture(self, share: float, alone: Bool[Tensor, " b"]) -> Float[Tensor, "b 4"]:
        """Return the weights of the passes at a share of the way to noise; `alone`: the coin took retrieval away.

        In float64, on the CPU, of which `alone` is.
        """
        if share <= FINE:
            last = 1 - self.both - self.text - self.retrieval
            rows = torch.tensor([self.both, self.text, self.retrieval, last], dtype=torch.float64)
            return rows.expand(len(alone), 4)
        w = 1 + self.coarse * share
        choices = torch.tensor([[w, 0, 1 - w, 0], [0, w, 0, 1 - w]], dtype=torch.float64)
        return choices[alone.long()]


def flip(seeds: Int[Tensor, " b"], time: int) -> Bool[Tensor, " b"]:
    """Flip each sample's coin for one step, a function of its seed and the time."""
    return torch.tensor([bool(item_seed(seed, 0, time) & 1) for seed in seeds.tolist()])
