"""Load and write MLD's published denoiser and autoencoder (one Lightning file; MLD §1-§2)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from kinema.generators.mld import MLD
from kinema.interop.checkpoint import count, require, transfer
from kinema.interop.torch_layers import DECODER_LAYER, ENCODER_LAYER, fuse_attention, split_attention, stack, tensors

# Published name -> ours, of layers that hold a weight and a bias.
LAYERS = {"time_embedding.linear_1": "time.0", "time_embedding.linear_2": "time.2", "emb_proj.1": "text_projection"}
UNUSED = "mem_pos.pe"
"""A table of the decoder that the published configuration doesn't build."""


def skip_layers(state: Mapping[str, Tensor], stem: str) -> int:
    """Count the layers of a published skip transformer."""
    return 2 * count(state, rf"{re.escape(stem)}\.input_blocks\.(\d+)\.") + 1


def skip_transformer(stem: str, layers: int, *, cross: bool = False) -> dict[str, str]:
    """Map the layers of a published skip transformer, attention split, to ours of the same name."""
    layer, half = DECODER_LAYER if cross else ENCODER_LAYER, layers // 2
    merges = {f"{stem}.linear_blocks.{i}": f"{stem}.merges.{i}" for i in range(half)}
    middle = {f"{stem}.middle_block.{a}": f"{stem}.middle.{b}" for a, b in layer.items()}
    ends = stack(layer, f"{stem}.input_blocks", f"{stem}.inputs", half)
    ends |= stack(layer, f"{stem}.output_blocks", f"{stem}.outputs", half)
    return ends | middle | merges | {f"{stem}.norm": f"{stem}.norm"}


def names(layers: int) -> dict[str, str]:
    """Map all published keys of the denoiser, attention split, to ours."""
    return tensors(LAYERS | skip_transformer("encoder", layers))


def load(
    state: Mapping[str, Tensor],
    *,
    latents: int = 1,
    heads: int = 4,
    steps: int = 1000,
    dropout: float = 0.1,
    condition_drop: float = 0.1,
    sampling: Mapping[str, Any] | None = None,
) -> nn.Module:
    """Load a published denoiser; `latents` is the autoencoder's number, which its keys don't tell."""
    kind = "mld"
    width, time_dim = require(state, "time_embedding.linear_1.weight", kind=kind).shape
    layers = skip_layers(state, "encoder")
    default = {"guidance": 7.5, "solver": "ddim", "solver_steps": "leading50"}
    spec = {
        "_target_": "kinema.generators.mld.MLD",
        "text_dim": require(state, "emb_proj.1.weight", kind=kind).shape[1],
        "latents": latents,
        "latent_dim": width,
        "feedforward": require(state, "encoder.middle_block.linear1.weight", kind=kind).shape[0],
        "layers": layers,
        "heads": heads,
        "dropout": dropout,
        "time_dim": time_dim,
        "positions": len(require(state, "query_pos.pe", kind=kind)),
        "condition_drop": condition_drop,
        "process": {"_target_": "kinema.diffusion.ddpm.DDPM", "steps": steps, "schedule": "scaled_linear"},
        "sampling": {"_target_": "kinema.generators.mld.LatentSampling", **default, **(sampling or {})},
    }
    state = split_attention(state)
    state["query_pos.pe"] = state["query_pos.pe"].squeeze(1)
    rules: list[tuple[str, str | None]] = [(re.escape(UNUSED), None), (r"query_pos\.pe", "denoiser.positions")]
    rules += [(re.escape(theirs), f"denoiser.{ours}") for theirs, ours in names(layers).items()]
    return transfer(spec, state, rules, kind=kind, ours=("empty_text",))


def export(model: MLD) -> dict[str, Tensor]:
    """Return a model's weights under the published keys; the table that nothing reads is zero."""
    own = model.denoiser.state_dict()
    layers = 2 * len(model.denoiser.encoder.inputs) + 1
    state = fuse_attention({theirs: own[ours] for theirs, ours in names(layers).items()})
    positions = own["positions"][:, None]
    return state | {"query_pos.pe": positions, UNUSED: torch.zeros_like(positions)}
