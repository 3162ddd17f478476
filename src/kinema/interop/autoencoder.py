"""Load MARDM's published autoencoders: `AE_humanml3d/model/latest.tar`, `AE_kit/model/net_best_fid.tar` (MARDM §9)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from kinema.interop.checkpoint import count, require, transfer
from kinema.interop.representation import fit_statistics, representation_spec


def conv_rules(levels: int, prefix: str = "") -> list[tuple[str, str]]:
    """Name the published conv encoder's and decoder's keys as ours (the same for all VQ tokenizers; COMMON §3)."""
    encoder, decoder = rf"{prefix}encoder\.model\.", rf"{prefix}decoder\.model\."
    rules = [
        (rf"{encoder}0\.(.+)", r"encoder.stem.\1"),
        (rf"{encoder}{levels + 2}\.(.+)", r"encoder.head.\1"),
        (rf"{decoder}0\.(.+)", r"decoder.stem.\1"),
        (rf"{decoder}{levels + 2}\.(.+)", r"decoder.mix.\1"),
        (rf"{decoder}{levels + 4}\.(.+)", r"decoder.head.\1"),
    ]
    for i in range(levels):
        rules += [
            (rf"{encoder}{i + 2}\.0\.(weight|bias)", rf"encoder.down.{i}.\1"),
            (rf"{encoder}{i + 2}\.1\.model\.(\d+)\.conv1\.(.+)", rf"encoder.stacks.{i}.blocks.\1.wide.\2"),
            (rf"{encoder}{i + 2}\.1\.model\.(\d+)\.conv2\.(.+)", rf"encoder.stacks.{i}.blocks.\1.point.\2"),
            (rf"{decoder}{i + 2}\.0\.model\.(\d+)\.conv1\.(.+)", rf"decoder.stacks.{i}.blocks.\1.wide.\2"),
            (rf"{decoder}{i + 2}\.0\.model\.(\d+)\.conv2\.(.+)", rf"decoder.stacks.{i}.blocks.\1.point.\2"),
            (rf"{decoder}{i + 2}\.2\.(weight|bias)", rf"decoder.up.{i}.\1"),
        ]
    return rules


def load(
    state: Mapping[str, Tensor],
    *,
    statistics: Any = None,
    dropout: float = 0.2,
    joint_weight: float = 1.0,
    mask_padding: bool = True,
    dilation_growth: int = 3,
) -> nn.Module:
    """Load a published autoencoder; `mask_padding=False` lets padding leak into the clips' ends, as published.

    `dilation_growth` of the residual stacks can't be told from shapes.
    """
    kind = "mardm-ae"
    width, features, _ = require(state, "encoder.model.0.weight", kind=kind).shape
    levels = count(state, r"encoder\.model\.(\d+)\.0\.weight")
    spec = {
        "_target_": "kinema.tokenizers.autoencoder.AutoEncoder",
        "representation": representation_spec(features),
        "width": width,
        "latent_dim": require(state, f"encoder.model.{levels + 2}.weight", kind=kind).shape[0],
        "depth": count(state, r"encoder\.model\.2\.1\.model\.(\d+)\."),
        "down_levels": levels,
        "dropout": dropout,
        "joint_weight": joint_weight,
        "mask_padding": mask_padding,
        "dilation_growth": dilation_growth,
    }
    return fit_statistics(transfer(spec, state, conv_rules(levels), kind=kind), statistics)
