"""Hold values in a flow by projecting its estimate of the clean data at every step (ProjFlow, FRONTIER §2.8)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from kinema.diffusion.guidance import Predict


def projected(
    velocity: Predict,
    noise: Iterator[Float[Tensor, "n *d"]],
    times: Sequence[float],
    known: tuple[Float[Tensor, "n *d"], Bool[Tensor, "n *d"]],
    source_scale: float,
    renewal: float | None = None,
) -> Float[Tensor, "n *d"]:
    """Step by Euler, the estimate of the clean data replaced where the mask of `known` (values, mask) is True.

    At every step a share `renewal` of the noise is drawn anew (None: as published, (1 - t) / s^2), so that the free
    values get to know the held ones. Of a Gaussian with a correlation of .8, the published share follows what is held
    by .44 of what it should after 100 steps, a share of .5 by .85; what doesn't depend on it loses a tenth of its
    deviation then. `noise` has the deviation `source_scale` s: the start, then one draw per step but the last. Held
    values come back as given.
    """
    values, mask = known
    x = next(noise)
    for t, end in pairwise(times):
        clean = torch.where(mask, values, x + (1 - t) * velocity(x, x.new_full((1,), t)))
        if end == times[-1]:
            return clean
        renewed = min(1.0, (1 - end) / source_scale**2) if renewal is None else renewal
        start = (1 - renewed) ** 0.5 * (x - t * clean) / (1 - t) + renewed**0.5 * next(noise)
        x = end * clean + (1 - end) * start
    return x
