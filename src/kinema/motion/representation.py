"""Choose the columns of a motion feature row, and normalise them: essential (67/64) or redundant (263/251)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from kinema.motion.skeleton import DIMS, SKELETONS, Skeleton, get_skeleton
from kinema.motion.statistics import Statistics
from kinema.options import OneOf, checked
from kinema.registry import buildable
from kinema.types import frame_mask

VARIANTS = ("raw", "published")

ROUNDED = 1e-4
"""Deviations by which statistics of one corpus may differ, computed on two kinds of machine."""


@buildable
class Representation(nn.Module):
    """Select, normalise and de-normalise features; belongs to the model that was trained on it and is saved with it.

    `variant` "raw" divides by the grouped deviation, "published" by the T2M family's (HUMANML3D_DATA §6). The
    statistics are buffers, NaN until `fit` or `load_state_dict`.
    """

    mean: Float[Tensor, " d"]
    std: Float[Tensor, " d"]

    @checked
    def __init__(
        self,
        kind: Annotated[str, OneOf(DIMS)],
        skeleton: Annotated[str, OneOf(SKELETONS)],
        variant: Annotated[str, OneOf(VARIANTS)] = "raw",
    ) -> None:
        super().__init__()
        self.kind, self.variant, self.skeleton_name = kind, variant, skeleton
        self.register_buffer("mean", torch.full((self.width,), torch.nan))
        self.register_buffer("std", torch.full((self.width,), torch.nan))
        self._fitted = False

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton that the features describe."""
        return get_skeleton(self.skeleton_name)

    @property
    def width(self) -> int:
        """Count the selected columns."""
        return self.skeleton.width_of(self.kind)

    @property
    def groups(self) -> dict[str, slice]:
        """Name the column groups that are selected."""
        return {name: columns for name, columns in self.skeleton.groups.items() if columns.stop <= self.width}

    def fit(self, statistics: Statistics) -> Representation:
        """Take raw grouped statistics of a corpus (at least `width` columns); applies the variant itself."""
        if len(statistics.mean) < self.width:
            raise ValueError(
                f"statistics have {len(statistics.mean)} columns, the {self.kind} representation of skeleton "
                f"{self.skeleton_name!r} needs {self.width}; compute them from features of that width"
            )
        chosen = statistics.published(self.skeleton) if self.variant == "published" else statistics
        self.mean.copy_(torch.from_numpy(chosen.mean[: self.width].astype(np.float32)))
        self.std.copy_(torch.from_numpy(chosen.std[: self.width].astype(np.float32)))
        self._fitted = True
        return self

    def normalize(
        self, features: Float[Tensor, "*b t w"], lengths: Int[Tensor, " b"] | None = None
    ) -> Float[Tensor, "*b t d"]:
        """Select the columns and normalise them; frames past the lengths become zero."""
        self._require_fitted()
        if features.shape[-1] < self.width:
            raise ValueError(
                f"features have {features.shape[-1]} columns, the {self.kind} representation of skeleton "
                f"{self.skeleton_name!r} needs at least {self.width}"
            )
        # NumPy's own numbers are double; the networks behind are not.
        features = features.float() if features.dtype == torch.float64 else features
        return _padded((features[..., : self.width] - self.mean) / self.std, lengths)

    def denormalize(
        self, values: Float[Tensor, "*b t d"], lengths: Int[Tensor, " b"] | None = None
    ) -> Float[Tensor, "*b t d"]:
        """Undo the normalisation; frames past the lengths become zero."""
        self._require_fitted()
        if values.shape[-1] != self.width:
            raise ValueError(f"values have {values.shape[-1]} columns, the {self.kind} representation has {self.width}")
        return _padded(values * self.std + self.mean, lengths)

    def identity(self) -> dict[str, str]:
        """Name what the numbers mean: kind, skeleton, variant and digest of the statistics in use."""
        self._require_fitted()
        used = Statistics(self.mean.cpu().numpy(), self.std.cpu().numpy())
        return {"kind": self.kind, "skeleton": self.skeleton_name, "variant": self.variant, "digest": used.digest()}

    def agrees(self, other: Representation) -> bool:
        """Say whether the numbers mean the same; statistics of one corpus may differ as machines round them."""
        mine, theirs = self.identity(), other.identity()
        if any(mine[key] != theirs[key] for key in ("kind", "skeleton", "variant")):
            return False
        shifts, ratios = (self.mean - other.mean.to(self.mean)) / self.std, other.std.to(self.std) / self.std
        return bool((shifts.abs() < ROUNDED).all() and ((ratios - 1).abs() < ROUNDED).all())

    @property
    def fitted(self) -> bool:
        """Whether it has statistics."""
        # Looked up once: reading a buffer costs a synchronisation on an accelerator.
        if not self._fitted:
            self._fitted = not bool(torch.isnan(self.mean).any() | torch.isnan(self.std).any())
        return self._fitted

    def _require_fitted(self) -> None:
        if not self.fitted:
            raise ValueError(
                "this representation has no statistics; call representation.fit(store.statistics) or load the "
                "weights of a trained model"
            )

    def _load_from_state_dict(self, *args: object, **kwargs: object) -> None:
        self._fitted = False
        super()._load_from_state_dict(*args, **kwargs)


def _padded(values: Float[Tensor, "*b t d"], lengths: Int[Tensor, " b"] | None) -> Float[Tensor, "*b t d"]:
    """Zero the frames past the lengths (NaN there too)."""
    if lengths is None:
        return values
    return values.masked_fill(~frame_mask(lengths, values.shape[-2])[..., None], 0)
