"""Return an imported model its representation: from the width of its input, fitted to statistics the caller brings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from torch import nn

from kinema.files.arrays import Wanted, read_npy
from kinema.motion.skeleton import SKELETONS
from kinema.motion.statistics import Statistics


def representation_spec(width: int, *, variant: str | None = None) -> dict[str, str]:
    """Describe the representation whose rows have `width` columns (67/64 essential, 263/251 redundant).

    Without a `variant`, essential rows take the raw statistics (MARDM §1), redundant ones the published (T2M family).
    """
    for skeleton in SKELETONS.values():
        for kind, columns in (("essential", skeleton.essential_width), ("redundant", skeleton.feature_width)):
            if columns == width:
                return {
                    "_target_": "kinema.motion.representation.Representation",
                    "kind": kind,
                    "skeleton": skeleton.name,
                    "variant": variant or ("raw" if kind == "essential" else "published"),
                }
    raise ValueError(f"this checkpoint reads features of width {width}; known: 67, 263 (HumanML3D), 64, 251 (KIT)")


def fit_statistics(module: Any, statistics: Any) -> nn.Module:
    """Fit a module's representation to statistics; None leaves it unfitted, which it says on first use."""
    if statistics is not None:
        module.representation.fit(read_statistics(statistics))
    return module


def read_statistics(source: Any) -> Statistics:
    """Take a `Statistics`, a file or folder that `Statistics.load` reads, or a pair of .npy paths (mean, std)."""
    if isinstance(source, Statistics):
        return source
    if isinstance(source, str | Path):
        if not Path(source).exists():
            raise FileNotFoundError(f"no statistics at {source}; give a folder with Mean.npy and Std.npy, or an .npz")
        return Statistics.load(source)
    if len(source) != 2:
        raise ValueError(f"statistics are a folder, an .npz or two .npy files (mean, std), not {len(source)} paths")
    mean, std = (read_npy(path, Wanted(shape=(None,))).astype(np.float64) for path in source)
    return Statistics(mean, std)
