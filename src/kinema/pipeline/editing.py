"""Say what an edit regenerates, and put what it keeps back: pure functions of frames, features and masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.motion.body_parts import columns_of
from kinema.motion.placement import Placement
from kinema.motion.recovery import recover_joints
from kinema.motion.skeleton import Skeleton
from kinema.pipeline.kept import stretches
from kinema.types import LatentSpace, Motion, MotionBatch, frame_mask

Ranges = list[tuple[int, int]]
"""Half-open ranges of frames to regenerate."""

TASKS = {
    "prefix": lambda n: [(n // 2, n)],
    "suffix": lambda n: [(0, n - n // 2)],
    "inbetween": lambda n: [(n // 4, n - n // 4)],
    "outpaint": lambda n: [(0, n // 4), (n // 4 + n // 2, n)],
}
"""The editing tasks of BAD §5 (MoMask, BAMM and MMM take the same), named by what is given: the first half, the second
half, both ends, the middle half. The rest is regenerated."""


SLOTS = {
    "prefix": lambda n: ((0, n // 2), (0, 0)),
    "suffix": lambda n: ((n - n // 2, n), (0, 0)),
    "inbetween": lambda n: ((0, n // 4), (n - n // 4, n)),
    "outpaint": lambda n: ((n // 4, n // 4 + n // 2), (0, 0)),
}
"""The token slots that the published evaluation keeps of a clip of n tokens (BAD §5)."""

SLICES = {
    "prefix": lambda n: [(0, 2 * n)],
    "suffix": lambda n: [(2 * n, 4 * n)],
    "inbetween": lambda n: [(0, n), (3 * n, 4 * n)],
    "outpaint": lambda n: [(n, 3 * n)],
}
"""The frames of a clip of 4n that it encodes for them, each slice by itself."""


def task_slots(task: str, tokens: Int[Tensor, " b"], size: int | None = None) -> Bool[Tensor, "b n"]:
    """Mark the token slots that a published editing task keeps of clips of `tokens` tokens (four frames each).

    The mask is `size` slots wide (default: the longest clip). The whole tokens that TASKS leaves are the same, except
    in outpaint: where a quarter of the clip is no whole number of tokens, they begin a token earlier here.
    """
    _check_task(task)
    slot = torch.arange(int(tokens.max()) if size is None else size, device=tokens.device)
    (first, end), (second, last) = SLOTS[task](tokens[:, None])
    return ((slot >= first) & (slot < end)) | ((slot >= second) & (slot < last))


def task_slices(task: str, tokens: int) -> Ranges:
    """Return the frames, [start, end) of a clip of 4 * `tokens`, that a published editing task encodes, each by itself.

    Of each slice's codes the first fill the kept slots; a rest of fewer than four frames has none.
    """
    _check_task(task)
    return SLICES[task](tokens)


def resolve_ranges(frames: str | Sequence[Any], lengths: Sequence[int]) -> list[Ranges]:
    """Return the ranges to regenerate of each motion.

    `frames` is a task's name, a list of (start, end) for all motions, or a list with one of these per motion.
    Raises ValueError for an unknown task, an empty list or a range outside its clip.
    """
    if isinstance(frames, str) or _is_ranges(frames):
        frames = [frames] * len(lengths)
    if len(frames) != len(lengths):
        raise ValueError(f"got ranges for {len(frames)} motions, but there are {len(lengths)}; give one list for each")
    return [_resolve(one, length) for one, length in zip(frames, lengths, strict=True)]


def edited_frames(ranges: Sequence[Ranges], size: int) -> Bool[Tensor, "b t"]:
    """Make a mask over frames that is True where an edit regenerates."""
    mask = torch.zeros(len(ranges), size, dtype=torch.bool)
    for row, spans in zip(mask, ranges, strict=True):
        for start, end in spans:
            row[start:end] = True
    return mask


def widened(edited: Bool[Tensor, "b t"], frames: Int[Tensor, " b"], space: LatentSpace) -> Bool[Tensor, "b t"]:
    """Keep whole latents where a kept stretch would hold none: the generator then knows it, and can lead to it.

    Pasted alone, a stretch would stand in motion that knows nothing of it. `frames` counts those of the clips without
    what fills up their last latents. Raises ValueError if that leaves nothing to regenerate.
    """
    unit = space.in_time("keeping a part of a motion")
    rows, starts, ends = stretches(~edited & frame_mask(frames, edited.shape[1]))
    ends = torch.where(ends == frames[rows], space.whole(ends), ends)
    first, last = starts // unit * unit, -(-ends // unit) * unit
    short = ends // unit <= -(-starts // unit)
    narrowed = edited.clone()
    for row, start, end in zip(rows[short], first[short], last[short], strict=True):
        narrowed[row, start:end] = False
    emptied = edited.any(1) & ~narrowed.any(1)
    if emptied.any():
        i = int(emptied.int().argmax())
        touched = edited[i].nonzero().flatten() // unit * unit
        whole = f"{int(touched[0])}:{min(int(touched[-1]) + unit, int(frames[i]))}"
        raise ValueError(
            f"nothing of motion {i} is left to regenerate: {unit} frames make one latent, and frames beside yours in "
            f"it are kept; regenerate whole latents, frames {whole} or more"
        )
    return narrowed


def kept_latents(edited: Bool[Tensor, "b t"], space: LatentSpace) -> Bool[Tensor, "b n"]:
    """Keep the latents none of whose frames is regenerated."""
    return ~edited.unflatten(1, (-1, space.in_time("keeping a part of a motion"))).any(-1)


def kept_frames(kept: Bool[Tensor, "b n"], space: LatentSpace) -> Bool[Tensor, "b t"]:
    """Mark the frames of kept latents."""
    return kept.repeat_interleave(space.in_time("keeping a part of a motion"), dim=1)


def edited_features(frames: Bool[Tensor, "b t"], part: str, skeleton: Skeleton, width: int) -> Bool[Tensor, "b t d"]:
    """Make a mask over the first `width` features that is True where an edit regenerates a part of the body."""
    columns = torch.from_numpy(columns_of(part, skeleton)[:width]).to(frames.device)
    return frames[..., None] & columns


def paste(
    result: MotionBatch, source: Float[Tensor, "b t d"], keep: Bool[Tensor, "b k"] | Bool[Tensor, "b k d"]
) -> MotionBatch:
    """Put what is kept of the source, rows or single features, in its place among the result's columns."""
    size, width = result.features.shape[1:]
    kept = (keep if keep.ndim == 3 else keep[..., None])[:, :size] & result.mask[..., None]
    return replace(result, features=torch.where(kept, source[:, :size, :width], result.features))


def stack_sources(
    motions: Sequence[Motion], width: int, space: LatentSpace
) -> tuple[Float[Tensor, "b t d"], Int[Tensor, " b"], Int[Tensor, " b"]]:
    """Stack feature rows, zero-padded; each clip's last row is repeated up to a whole number of latents.

    Gives (features, frames of the clips, frames with the repetition).
    """
    frames = torch.tensor([len(m.features) for m in motions])
    filled = space.whole(frames)
    stacked = np.zeros((len(motions), int(filled.max()), width), np.float32)
    for row, motion, end in zip(stacked, motions, filled.tolist(), strict=True):
        row[: len(motion.features)] = motion.features[:, :width]
        row[len(motion.features) : end] = motion.features[-1, :width]
    return torch.from_numpy(stacked), frames, filled


def parse_ranges(text: str, length: int, fps: float, *, kept: bool = False) -> Ranges:
    """Read "20:60,80:" (frames) or "1s:2.5s" (seconds), or a named task, as the ranges to regenerate.

    With `kept` the ranges are those that stay. A task is named by what stays, however it is asked for.
    """
    if text in TASKS:
        return _resolve(text, length)
    ranges = []
    for part in text.split(","):
        start, separator, end = part.partition(":")
        if not separator:
            tasks = ", ".join(TASKS)
            raise ValueError(f"range {part!r} is no START:END; give frames (20:60), seconds (1s:2.5s) or {tasks}")
        ranges.append((_frame(start or "0", fps), _frame(end or str(length), fps)))
    found = _resolve(ranges, length)
    return complement(found, length) if kept else found


def parse_frames(text: str, length: int, fps: float) -> list[int]:
    """Read "0,40,79" (frames) or "0s,2s" (seconds) as frames of a clip; -1 is the last."""
    found = [_frame(part, fps) for part in text.split(",")]
    for frame in found:
        if not -length <= frame < length:
            raise ValueError(f"frame {frame} is outside the clip; it has frames 0 to {length - 1} (-1 is the last)")
    return sorted({frame % length for frame in found})


def complement(ranges: Ranges, length: int) -> Ranges:
    """Return the ranges between the ranges."""
    edited = edited_frames([ranges], length)[0].tolist()
    borders = [i for i in range(length + 1) if (i < length and not edited[i]) != (i > 0 and not edited[i - 1])]
    return list(zip(borders[::2], borders[1::2], strict=True))


def in_place(made: Motion, source: Motion, skeleton: Skeleton) -> Motion:
    """Put an edit where its source's joints are: features know neither place nor facing (HUMANML3D_DATA §3)."""
    rows = recover_joints(torch.from_numpy(source.features), skeleton).numpy()
    return replace(made, joints=Placement.between(rows, source.joints, skeleton).apply(made.joints))


def strayed(motion: Motion, skeleton: Skeleton) -> float:
    """Return how far a joint of a motion's rows lies from where the motion has it, at most, in the skeleton's unit.

    An edit keeps rows: those that were extracted from another body's joints have the bones of the skeleton.
    """
    rows = recover_joints(torch.from_numpy(motion.features), skeleton).numpy()
    placed, frames = Placement.between(rows, motion.joints, skeleton).apply(rows), min(len(rows), len(motion.joints))
    return float(np.linalg.norm(placed[:frames] - motion.joints[:frames], axis=-1).max())


def largest_seam(motion: Motion) -> tuple[int, float] | None:
    """Return the frame between kept and new motion into which a joint moves farthest, and how far; None: no seam."""
    if motion.kept is None:
        return None
    seams = np.flatnonzero(motion.kept[1:] != motion.kept[:-1]) + 1
    if not len(seams):
        return None
    steps = np.linalg.norm(motion.joints[seams] - motion.joints[seams - 1], axis=-1).max(-1)
    return int(seams[steps.argmax()]), float(steps.max())


def _frame(text: str, fps: float) -> int:
    try:
        return round(float(text[:-1]) * fps) if text.endswith("s") else int(text)
    except (ValueError, OverflowError):
        raise ValueError(f"{text!r} is neither a frame (20) nor a time in seconds (1.5s)") from None


def _is_ranges(frames: Sequence[Any]) -> bool:
    return all(
        not isinstance(r, str) and len(r) == 2 and all(isinstance(v, int | np.integer) for v in r) for r in frames
    )


def _resolve(frames: str | Ranges, length: int) -> Ranges:
    if isinstance(frames, str):
        if frames not in TASKS:
            raise ValueError(f"unknown edit {frames!r}; allowed: {', '.join(TASKS)}, or (start, end) ranges of frames")
        return [(start, end) for start, end in TASKS[frames](length) if start < end]
    if not frames:
        raise ValueError("nothing to regenerate: give at least one (start, end) range of frames")
    for start, end in frames:
        if not 0 <= start < end <= length:
            raise ValueError(
                f"range ({start}, {end}) is outside the clip; it has frames 0 to {length}, and start < end"
            )
    return [(int(start), int(end)) for start, end in frames]


def _check_task(task: str) -> None:
    if task not in SLOTS:
        raise ValueError(f"unknown editing task {task!r}; allowed: {', '.join(SLOTS)}")
