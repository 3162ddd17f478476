"""Load and write MARDM's published transformer with its diffusion MLP (`latest.tar`, entry `ema_mardm`; MARDM §9)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from kinema.generators.mar.model import MARDM
from kinema.interop.checkpoint import count, require, transfer
from kinema.interop.torch_layers import stack, tensors
from kinema.nn.embeddings import sinusoidal_positions

VARIANTS = {"ddpm": "kinema.diffusion.ddpm.DDPM", "sit": "kinema.diffusion.flow.Flow"}
POSITIONS = 5000

# Published name -> ours, of layers that hold a weight and a bias.
TRANSFORMER = {"input_process.poseEmbedding": "input_projection", "cond_emb": "text_projection"}
TRANSFORMER_BLOCK = {
    **{f"attn.{p}": f"attention.{p}" for p in ("query", "key", "value", "proj")},
    "mlp.fc1": "mlp.0",
    "mlp.fc2": "mlp.2",
    "adaLN_modulation.1": "modulation.1",
}
MLP = {
    "net.input_proj": "input_projection",
    "net.cond_embed": "embed_condition",
    "net.time_embed.mlp.0": "time.0",
    "net.time_embed.mlp.2": "time.2",
    "net.final_layer.linear": "final.linear",
    "net.final_layer.adaLN_modulation.1": "final.modulation",
}
MLP_BLOCK = {
    "in_ln": "norm",
    "mlp.0": "mlp.0",
    "mlp.2": "mlp.2",
    "adaLN_modulation.1": "modulation",
}


def mlp_names(depth: int) -> dict[str, str]:
    """Map the diffusion MLP's published keys to ours."""
    return tensors(MLP | stack(MLP_BLOCK, "net.res_blocks", "blocks", depth))


def names(layers: int, depth: int) -> dict[str, str]:
    """Map all published keys with tensors of the same shape to ours."""
    transformer = tensors(TRANSFORMER | stack(TRANSFORMER_BLOCK, "MARTransformer", "blocks", layers))
    return transformer | {f"DiffMLPs.{theirs}": f"mlp.{ours}" for theirs, ours in mlp_names(depth).items()}


def load(
    state: Mapping[str, Tensor],
    *,
    variant: str,
    heads: int = 16,
    dropout: float = 0.2,
    condition_drop: float = 0.1,
    batch_multiplier: int = 4,
    max_latents: int = 49,
    sampling: Mapping[str, Any] | None = None,
) -> nn.Module:
    """Load a published MARDM; `variant` is "ddpm" or "sit" (its keys don't tell), sizes follow from the shapes."""
    kind = "mardm"
    if variant not in VARIANTS:
        raise ValueError(f"variant {variant!r} is unknown; choose one of {', '.join(VARIANTS)} (MARDM-DDPM, MARDM-SiT)")
    width, latent_dim = require(state, "input_process.poseEmbedding.weight", kind=kind).shape
    layers = count(state, r"MARTransformer\.(\d+)\.")
    depth = count(state, r"DiffMLPs\.net\.res_blocks\.(\d+)\.")
    spec = {
        "_target_": "kinema.generators.mar.MARDM",
        "latent_dim": latent_dim,
        "text_dim": require(state, "cond_emb.weight", kind=kind).shape[1],
        "width": width,
        "feedforward": require(state, "MARTransformer.0.mlp.fc1.weight", kind=kind).shape[0],
        "layers": layers,
        "heads": heads,
        "dropout": dropout,
        "condition_drop": condition_drop,
        "mlp_width": require(state, "DiffMLPs.net.input_proj.weight", kind=kind).shape[0],
        "mlp_depth": depth,
        "batch_multiplier": batch_multiplier,
        "max_latents": max_latents,
        "process": {"_target_": VARIANTS[variant]},
        "sampling": {"_target_": "kinema.generators.mar.MarSampling", **(sampling or {})},
    }
    rules: list[tuple[str, str | None]] = [(re.escape(theirs), ours) for theirs, ours in names(layers, depth).items()]
    rules += [("mask_latent|latent_min|latent_max", r"\g<0>"), (r"position_enc\.pe", None)]
    unknown_range = {
        "latent_min": torch.full((latent_dim,), -torch.inf),
        "latent_max": torch.full((latent_dim,), torch.inf),
    }
    flat = {"mask_latent": require(state, "mask_latent", kind=kind).flatten()}
    return transfer(spec, {**state, **flat, **unknown_range}, rules, kind=kind)


def export(model: MARDM) -> dict[str, Tensor]:
    """Return a model's weights under the published keys, the table of positions included."""
    own = model.state_dict()
    state = {theirs: own[ours] for theirs, ours in names(len(model.blocks), len(model.mlp.blocks)).items()}
    width = model.input_projection.out_features
    positions = sinusoidal_positions(POSITIONS, width, model.mask_latent.device)
    return state | {"mask_latent": own["mask_latent"][None, None], "position_enc.pe": positions[:, None]}
