"""Load MARDM's and MoMask's published length estimator: `length_estimator/model/finest.tar` (MARDM §9)."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor, nn

from kinema.interop.checkpoint import require, transfer


def load(state: Mapping[str, Tensor], *, downsample: int = 4, dropout: float = 0.2) -> nn.Module:
    """Load a published length estimator; a class stands for `downsample` frames."""
    kind = "length-estimator"
    spec = {
        "_target_": "kinema.generators.length.LengthEstimator",
        "text_dim": require(state, "output.0.weight", kind=kind).shape[1],
        "classes": require(state, "output.11.weight", kind=kind).shape[0],
        "downsample": downsample,
        "dropout": dropout,
    }
    return transfer(spec, state, [(r"output\.(.+)", r"layers.\1")], kind=kind)
