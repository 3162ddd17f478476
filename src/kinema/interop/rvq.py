"""Load MoMask's and BAMM's published RVQ-VAE: `rvq_nq6_dc512_nc512_.../model/net_best_fid.tar` (MoMask §1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from kinema.interop.autoencoder import conv_rules
from kinema.interop.checkpoint import count
from kinema.interop.representation import fit_statistics
from kinema.interop.vq import network, transfer_codes


def load(
    state: Mapping[str, Tensor],
    *,
    statistics: Any = None,
    variant: str | None = None,
    dropout: float = 0.2,
    quantizer_dropout: float = 0.2,
    temperature: float = 0.5,
    mask_padding: bool = True,
    dilation_growth: int = 3,
) -> nn.Module:
    """Load a published RVQ-VAE; `variant` as in `vq.load`.

    `mask_padding=False` lets padding leak into the clips' ends, as published.
    `dilation_growth` of the residual stacks can't be told from shapes.
    """
    kind = "momask-rvq"
    net = network(state, kind, variant)
    spec = {
        "_target_": "kinema.tokenizers.vq.VQVAE",
        **net,
        "quantizer": {
            "_target_": "kinema.tokenizers.rvq.ResidualQuantizer",
            "codebook_size": net["codebook_size"],
            "code_dim": net["code_dim"],
            "quantizers": count(state, r"quantizer\.layers\.(\d+)\."),
            "quantizer_dropout": quantizer_dropout,
            "temperature": temperature,
        },
        "dropout": dropout,
        "mask_padding": mask_padding,
        "dilation_growth": dilation_growth,
    }
    rules = [*conv_rules(net["down_levels"]), (r"quantizer\.layers\.(\d+)\.codebook", r"quantizer.layers.\1.codebook")]
    return fit_statistics(transfer_codes(spec, state, rules, kind=kind), statistics)
