"""Refuse NaN and infinity where they enter, by the name of the clip."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor


def require_finite(values: Float[Tensor, "b *d"], what: str, names: Sequence[str] = ()) -> None:
    """Raise ValueError that names the first rows that hold NaN or infinity (by number without `names`)."""
    bad = (~torch.isfinite(values)).flatten(1).any(dim=1).nonzero().flatten().tolist()
    if bad:
        listed = ", ".join(names[i] if names else f"row {i}" for i in bad[:3])
        more = f" and {len(bad) - 3} more" if len(bad) > 3 else ""
        raise ValueError(
            f"{what} of {listed}{more} hold NaN or infinity; a diverged model makes them (lower its learning rate or "
            "guidance, clip its latents), or the clip itself does (check it with `kinema doctor`)"
        )
