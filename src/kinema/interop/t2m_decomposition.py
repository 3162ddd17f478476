"""Load the movement autoencoder whose encoder the T2M-style evaluator reads: `Decomp_*/model/latest.tar`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from kinema.interop.checkpoint import require, transfer
from kinema.interop.representation import fit_statistics, representation_spec
from kinema.interop.t2m_evaluator import OURS


def load(state: Mapping[str, Tensor], *, statistics: Any = None, variant: str | None = None) -> nn.Module:
    """Load a published movement autoencoder (`movement_enc`, `movement_dec`); `variant` as the evaluator's."""
    kind = "t2m-decomposition"
    width, inputs, _ = require(state, "movement_enc.main.0.weight", kind=kind).shape
    outputs = require(state, "movement_dec.out_net.weight", kind=kind).shape[0]
    spec = {
        "_target_": "kinema.evaluation.encoders.t2m.DecompositionAutoencoder",
        "representation": representation_spec(outputs, variant=variant),
        "width": width,
        "latent_dim": require(state, "movement_enc.out_net.weight", kind=kind).shape[0],
        "drop_contacts": inputs != outputs,
    }
    rules = [(r"movement_enc\.(.+)", r"movement_encoder.\1"), (r"movement_dec\.(.+)", r"movement_decoder.\1")]
    return fit_statistics(transfer(spec, state, rules, kind=kind, ours=OURS), statistics)
