"""Load published VQ-VAEs: T2M-GPT's `VQVAE/net_last.pth` and the tokenizer that MMM and BAD share (`vq_last.pth`).

Both are one network; what the shapes cannot tell is how the codebook was trained (COMMON §4), which only matters to
those who train on.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from kinema.interop.autoencoder import conv_rules
from kinema.interop.checkpoint import Rules, count, require, transfer
from kinema.interop.representation import fit_statistics, representation_spec
from kinema.tokenizers.codebook import EMACodebook

LARGE = 8192
"""From so many codes on, a checkpoint is MMM's or BAD's, who reset unused codes only."""


def load(
    state: Mapping[str, Tensor],
    *,
    statistics: Any = None,
    variant: str | None = None,
    reset: str | None = None,
    mask_padding: bool = True,
    dilation_growth: int = 3,
) -> nn.Module:
    """Load a published VQ-VAE; `reset` (EMACodebook's, default by the number of codes) is for training on.

    `variant="raw"` is for statistics that were shipped with the published code, whose deviations are divided already
    (as `t2m_evaluator.load` has it). `mask_padding=False` lets padding leak into the clips' ends.
    `dilation_growth` of the residual stacks can't be told from shapes.
    """
    kind = "t2m-gpt-vq"
    # The network stands below this name in T2M-GPT's files and its descendants'.
    state = {k.removeprefix("vqvae."): v for k, v in state.items()}
    size, dim = require(state, "quantizer.codebook", kind=kind).shape
    spec = {
        "_target_": "kinema.tokenizers.vq.VQVAE",
        **network(state, kind, variant),
        "quantizer": {
            "_target_": "kinema.tokenizers.codebook.EMACodebook",
            "codebook_size": size,
            "code_dim": dim,
            "reset": reset or ("unused" if size >= LARGE else "always"),
        },
        "mask_padding": mask_padding,
        "dilation_growth": dilation_growth,
    }
    rules = [*conv_rules(spec["down_levels"]), (r"quantizer\.codebook", "quantizer.codebook")]
    return fit_statistics(transfer_codes(spec, state, rules, kind=kind), statistics)


def network(state: Mapping[str, Tensor], kind: str, variant: str | None = None) -> dict[str, Any]:
    """Describe the representation and the conv net of a published tokenizer of codes."""
    width, _, _ = require(state, "encoder.model.0.weight", kind=kind).shape
    levels = count(state, r"encoder\.model\.(\d+)\.0\.weight")
    features = require(state, f"decoder.model.{levels + 4}.weight", kind=kind).shape[0]
    first = "quantizer.codebook" if "quantizer.codebook" in state else "quantizer.layers.0.codebook"
    size, dim = require(state, first, kind=kind).shape
    return {
        "representation": representation_spec(features, variant=variant),
        "codebook_size": size,
        "code_dim": dim,
        "width": width,
        "depth": count(state, r"encoder\.model\.2\.1\.model\.(\d+)\."),
        "down_levels": levels,
    }


def transfer_codes(spec: dict[str, Any], state: Mapping[str, Tensor], rules: Rules, *, kind: str) -> nn.Module:
    """Build the tokenizer with the published weights; its codebooks' counts, which no file holds, start anew."""
    layers = count(state, r"quantizer\.layers\.(\d+)\.")
    places = [f"quantizer.layers.{i}." for i in range(layers)] or ["quantizer."]
    counted = [place + name for place in places for name in ("sums", "counts", "initialised", "used", "counter")]
    module = transfer(spec, state, rules, kind=kind, ours=("representation.", *counted))
    for part in module.modules():
        if isinstance(part, EMACodebook):
            part.start_from(part.codebook.clone())
    return module
