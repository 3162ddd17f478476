"""Load AttT2M's published tokenizer: `pretrain_models/HumanML3D/VQVAE/net_last.pth`, entry `net` (AttT2M)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from kinema.interop.autoencoder import conv_rules
from kinema.interop.checkpoint import Rules, count, require
from kinema.interop.representation import fit_statistics
from kinema.interop.torch_layers import split_attention
from kinema.interop.vq import network, transfer_codes

KIND = "attt2m-vq"
SPATIAL = "encoder.spatial_transformer"
PARTS = f"{SPATIAL}.parameter_part"
LAYERS = rf"{SPATIAL}.spatialTransEncoder.layers\.(\d+)"


def load(
    state: Mapping[str, Tensor],
    *,
    statistics: Any = None,
    variant: str | None = None,
    heads: int = 4,
    dropout: float = 0.2,
    mask_padding: bool = True,
    dilation_growth: int = 3,
) -> nn.Module:
    """Load a published tokenizer with its body-part encoder; `heads` cannot be told from shapes.

    `variant` as in `vq.load`; `mask_padding=False` lets padding leak into the clips' ends. `dilation_growth` of the
    residual stacks can't be told either.
    """
    state = {k.removeprefix("vqvae."): v for k, v in state.items()}
    parts = body_parts(state)
    state[PARTS] = require(state, PARTS, kind=KIND).flatten(0, 1)
    net = network(state, KIND, variant)
    spec = {
        "_target_": "kinema.tokenizers.vq.VQVAE",
        **net,
        "encoder": {
            "_target_": "kinema.tokenizers.body_parts.BodyPartEncoder",
            "skeleton": net["representation"]["skeleton"],
            "kind": net["representation"]["kind"],
            **{name: net[name] for name in ("code_dim", "width", "depth", "down_levels")},
            **parts,
            "heads": heads,
            "dropout": dropout,
            "dilation_growth": dilation_growth,
        },
        "auxiliary": "velocities",
        "mask_padding": mask_padding,
        "dilation_growth": dilation_growth,
    }
    module = transfer_codes(spec, split_attention(state), rules(net["down_levels"]), kind=KIND)
    return fit_statistics(module, statistics)


def body_parts(state: Mapping[str, Tensor]) -> dict[str, int]:
    """Derive the sizes of what comes before the conv encoder."""
    hidden, node = require(state, f"{SPATIAL}.joint_pos_encoder.linear1.weight", kind=KIND).shape
    feedforward, part = require(state, f"{SPATIAL}.spatialTransEncoder.layers.0.linear1.weight", kind=KIND).shape
    return {
        "node_width": node,
        "node_hidden": hidden,
        "part_width": part,
        "feedforward": feedforward,
        "layers": count(state, LAYERS),
    }


def rules(levels: int) -> Rules:
    """Rename the published keys, the attentions split; the conv encoder is a part of ours."""
    conv = [
        (theirs, f"encoder.conv.{ours.removeprefix('encoder.')}" if ours.startswith("encoder.") else ours)
        for theirs, ours in conv_rules(levels)
    ]
    layer = {
        r"self_attn\.(query|key|value)": r"attention.\2",
        r"self_attn\.(out_proj)": "attention.proj",
        "(linear1)": "mlp.0",
        "(linear2)": "mlp.3",
        "(norm[12])": r"\2",
    }
    return [
        *conv,
        *((rf"{LAYERS}\.{theirs}\.(.+)", rf"encoder.blocks.\1.{ours}.\3") for theirs, ours in layer.items()),
        (rf"{SPATIAL}.joint_pos_encoder.linear1\.(.+)", r"encoder.token.0.\1"),
        (rf"{SPATIAL}.joint_pos_encoder.linear2\.(.+)", r"encoder.token.2.\1"),
        (rf"{SPATIAL}.joint_pos_encoder.pe", None),  # a constant, computed anew
        (PARTS, "encoder.parts"),
        (r"encoder.root_joint_embed\.(.+)", r"encoder.root.\1"),
        (r"encoder.other_joint_embed\.(.+)", r"encoder.joint.\1"),
        (r"encoder.contact_embed\.(.+)", r"encoder.contact.\1"),
        (r"quantizer\.codebook", "quantizer.codebook"),
    ]
