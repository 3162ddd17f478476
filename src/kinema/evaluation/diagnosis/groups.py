"""Summarise what is measured of columns by the feature groups that they belong to."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float


def by_group(groups: Mapping[str, slice], values: Float[np.ndarray, " d"], name: str) -> dict[str, dict[str, float]]:
    """Return NAME_least, NAME_median and NAME_most of each group's columns, those without a value left out."""
    found = {}
    for group, columns in groups.items():
        chosen = values[columns][np.isfinite(values[columns])]
        least, median, most = np.quantile(chosen, (0.0, 0.5, 1.0)).tolist() if len(chosen) else (np.nan,) * 3
        found[group] = {f"{name}_least": least, f"{name}_median": median, f"{name}_most": most}
    return found


def shares(groups: Mapping[str, slice], losses: Float[np.ndarray, " d"]) -> dict[str, dict[str, float]]:
    """Split a mean over columns into groups: L = sum over groups of D_g / D * L_g (our reading of MARDM Eq. 3).

    `columns` is D_g / D, `loss` L_g, `share` the group's part of L.
    """
    total = losses.sum()
    return {
        group: {
            "columns": len(losses[part]) / len(losses),
            "loss": losses[part].mean().item(),
            "share": (losses[part].sum() / total).item() if total > 0 else 0.0,
        }
        for group, part in groups.items()
    }
