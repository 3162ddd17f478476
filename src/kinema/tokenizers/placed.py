"""See motion as joints in space, normalised: what tokenizers of absolute joints share (FRONTIER §2.1)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.motion.recovery import recover_joints
from kinema.motion.representation import Representation
from kinema.motion.rows import essential_rows
from kinema.motion.statistics import Statistics, moments
from kinema.motion.trajectory import faced
from kinema.tokenizers import MotionTokenizer, pieces
from kinema.types import Latents, MotionBatch, frame_mask

STATISTICS = ("shared_axis", "per_joint")


class PlacedTokenizer(MotionTokenizer):
    """Recover joints from feature rows and normalise them, and describe joints by essential rows again.

    Frame 0 stands at the origin, and faces +Z as far as its row says. `statistics` "shared_axis": one mean and one
    deviation per axis over all joints and frames of the training clips (published); "per_joint": one per coordinate.
    They are buffers, NaN until `prepare` or `load_state_dict`.
    """

    placed = True
    mean: Float[Tensor, "j 3"]
    std: Float[Tensor, "j 3"]

    def __init__(self, representation: Representation, statistics: str) -> None:
        super().__init__()
        if representation.kind != "essential":
            raise ValueError(
                f"joints are described by essential rows, not by {representation.kind} ones; set "
                "representation=essential (a judge of all dims reads them with lift=true)"
            )
        self.representation, self.statistics = representation, statistics
        joints = representation.skeleton.num_joints
        self.register_buffer("mean", torch.full((joints, 3), torch.nan))
        self.register_buffer("std", torch.full((joints, 3), torch.nan))

    def prepare(self, clips: Iterable[np.ndarray]) -> None:
        """Take the statistics of the joints."""
        skeleton = self.representation.skeleton
        mean, std = moments(
            recover_joints(torch.from_numpy(np.asarray(rows, np.float64)), skeleton).flatten(1).numpy()
            for rows in clips
        )
        for buffer, values in zip(
            (self.mean, self.std), self.pooled(mean.reshape(-1, 3), std.reshape(-1, 3)), strict=True
        ):
            buffer.copy_(values)

    def pooled(
        self, mean: Float[np.ndarray, "j c"], std: Float[np.ndarray, "j c"]
    ) -> tuple[Float[Tensor, "j c"], Float[Tensor, "j c"]]:
        """Pool moments over the joints, where they share them; what never changes is divided by 1."""
        if self.statistics == "shared_axis":
            whole = mean.mean(0)
            squares = (np.square(std) + np.square(mean)).mean(0) - np.square(whole)
            mean, std = (np.broadcast_to(values, mean.shape) for values in (whole, np.sqrt(squares)))
        std = np.where(std > 0, std, 1)
        return torch.from_numpy(mean.astype(np.float32)), torch.from_numpy(std.astype(np.float32))

    def identity(self) -> dict[str, str]:
        """Name the rows' representation, and the statistics of the joints."""
        own = Statistics(self._fitted(self.mean).flatten().cpu().numpy(), self.std.flatten().cpu().numpy())
        return {**self.representation.identity(), "joints": f"{self.statistics} {own.digest()}"}

    def place(self, motion: MotionBatch) -> Float[Tensor, "b t j 3"]:
        """Recover and normalise the joints of de-normalised rows, zero past the lengths."""
        return self.normalize(self.recovered(motion), motion.mask)

    def recovered(self, motion: MotionBatch) -> Float[Tensor, "b t j 3"]:
        """Recover the joints of de-normalised rows, in the skeleton's unit."""
        # NumPy's own numbers are double; the networks behind are not.
        rows = motion.features.float() if motion.features.dtype == torch.float64 else motion.features
        return recover_joints(rows, self.representation.skeleton)

    def normalize(self, joints: Float[Tensor, "b t j 3"], real: Bool[Tensor, "b t"]) -> Float[Tensor, "b t j 3"]:
        """Normalise joints, zero where frames aren't real."""
        return ((joints - self._fitted(self.mean)) / self.std).masked_fill(~real[..., None, None], 0.0)

    def describe(self, values: Float[Tensor, "b t j 3"], frames: Int[Tensor, " b"]) -> MotionBatch:
        """Describe normalised joints by rows, zero past `frames`."""
        joints = values * self.std + self._fitted(self.mean)
        return MotionBatch(essential_rows(joints, frames, self.representation.skeleton), frames)

    @abstractmethod
    def encode_joints(self, values: Float[Tensor, "b t j 3"], lengths: Int[Tensor, " b"]) -> Latents:
        """Encode normalised joints; what lies past the lengths is not read."""

    def encode(self, motion: MotionBatch, *, generator: torch.Generator | None = None) -> Latents:
        """Encode the joints that de-normalised rows describe."""
        return self.encode_joints(self.place(motion), motion.lengths)

    def encode_pieces(
        self, motion: MotionBatch, rows: Int[Tensor, " p"], starts: Int[Tensor, " p"], lengths: Int[Tensor, " p"]
    ) -> Latents:
        """Encode pieces of motions where they stand in them."""
        return self.encode_joints(pieces(self.place(motion), rows, starts, lengths), lengths)

    def described(
        self,
        made: MotionBatch,
        source: Float[Tensor, "b t d"],
        keep: Bool[Tensor, "b t"] | Bool[Tensor, "b t d"],
    ) -> MotionBatch:
        """Describe decoded motion by its source's headings where something of that is kept: the joints stay.

        Rows of joints are relative to a heading that is smoothed over four seconds to both sides, so that an edit
        changes also those of what it keeps.
        """
        held = (keep if keep.ndim == 2 else keep.any(-1)) & frame_mask(made.lengths, keep.shape[1])
        rows, given = made.features.cpu().numpy().copy(), source.cpu().numpy()
        for i, size in enumerate(made.lengths.tolist()):
            rows[i, :size] = faced(
                rows[i, :size], given[i, :size], held[i, :size].cpu().numpy(), self.representation.skeleton
            )
        return MotionBatch(torch.from_numpy(rows).to(made.features), made.lengths)

    def _fitted(self, values: Tensor) -> Tensor:
        if bool(values.isnan().any()):
            raise ValueError(
                "this tokenizer has no statistics of joints; call prepare(clips) with the feature rows of the training "
                "clips, or load the weights of a run"
            )
        return values
