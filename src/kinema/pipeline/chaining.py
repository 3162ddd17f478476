"""Join generated parts into one long motion: windows with room for a transition, and the parts with it in between."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from kinema.pipeline.blending import BLEND, put_back
from kinema.pipeline.editing import kept_frames
from kinema.pipeline.kept import encode_kept
from kinema.tokenizers import MotionTokenizer
from kinema.types import Known, Latents, LatentSpace, MotionBatch, frame_mask

TRANSITION = 8
"""Frames of a transition, unless others are asked for."""

Fill = Callable[[Known], Latents]
"""Generate what windows leave free."""


def chained(
    tokenizer: MotionTokenizer, parts: Latents, transition: int, most: int, fill: Fill
) -> tuple[MotionBatch, Bool[Tensor, "1 t"]]:
    """Join parts to one motion, by transitions that `fill` generates; the mask is True at the parts' own frames.

    All latents are decoded at once (BAD §5). Latents that say where joints stand have no place in another motion:
    there the parts' rows are joined, and a window of them is taken to stand where its rows lead, the way through the
    transition that of the last row before it.
    """
    space = tokenizer.space
    if not tokenizer.placed:
        windows = bridges(parts, space, transition, most)
        whole, own = join(parts, space, fill(windows), ~windows.mask & windows.latents.mask)
        return tokenizer.decode(whole), kept_frames(own, space)
    rows = _grouped(tokenizer.decode(parts), space)
    windows = bridges(rows, space, transition, most)
    source, keep = _rows(windows.latents, space), kept_frames(windows.mask, space)
    last = torch.where(keep, torch.arange(keep.shape[1], device=keep.device), -1).cummax(dim=1).values
    steady = source.features.gather(1, last[..., None].expand_as(source.features))
    source = MotionBatch(steady * source.mask[..., None], source.lengths)
    made = tokenizer.decode(fill(encode_kept(tokenizer, source, windows.mask)))
    made = tokenizer.described(made, source.features, keep)
    made = put_back(made, source.features, keep, tokenizer.representation.skeleton, BLEND)
    whole, own = join(rows, space, _grouped(made, space), ~windows.mask & windows.latents.mask)
    return _rows(whole, space), kept_frames(own, space)


def bridges(parts: Latents, space: LatentSpace, transition: int, most: int) -> Known:
    """Make one window for each pair of neighbours: [last half | free latents | first half] (BAD §5).

    `transition` counts frames, and is rounded up to whole latents. A half is half of its part, less where the window
    would exceed `most` latents. Raises ValueError for a transition that leaves no room for what it joins.
    """
    free = space.latents_of(space.whole(transition))
    half = (most - free) // 2
    if transition < 1 or half < 1:
        raise ValueError(
            f"a transition of {transition} frames does not fit; allowed: 1 to {space.frames_of(most - 2)} frames"
        )
    left = (parts.lengths[:-1] // 2).clamp(1, half)
    right = (parts.lengths[1:] // 2).clamp(1, half)
    lengths = left + free + right
    position = torch.arange(int(lengths.max()), device=lengths.device)
    from_left = position - left[:, None] + parts.lengths[:-1, None]
    from_right = position - (left + free)[:, None]
    is_left, is_right = from_left < parts.lengths[:-1, None], from_right >= 0
    keep = (is_left | is_right) & frame_mask(lengths, len(position))
    gathered = torch.where(
        is_left[..., None], _take(parts.content[:-1], from_left), _take(parts.content[1:], from_right)
    )
    return Known(parts.holding(gathered * keep[..., None], lengths, space.frames_of(lengths)), keep)


def join(
    parts: Latents, space: LatentSpace, bridged: Latents, free: Bool[Tensor, "b n"]
) -> tuple[Latents, Bool[Tensor, "1 m"]]:
    """Put what was generated between the parts (`free` in each window) between them: one sequence.

    The mask is True at the parts' own latents.
    """
    content, between = parts.content, bridged.content
    pieces = []
    for i, length in enumerate(parts.lengths.tolist()):
        pieces.append(content[i, :length])
        if i < len(between):
            pieces.append(between[i][free[i]])
    whole = torch.cat(pieces)[None]
    own = torch.cat([torch.full((len(piece),), i % 2 == 0) for i, piece in enumerate(pieces)])[None]
    lengths = torch.tensor([whole.shape[1]], device=parts.lengths.device)
    return parts.holding(whole, lengths, space.frames_of(lengths)), own.to(whole.device)


def shared_out(count: int, space: LatentSpace, transition: int, most: int) -> list[int]:
    """Share so many frames out to parts of at most `most` latents each, with transitions between them.

    All are whole latents; a motion that needs no second part keeps its count.
    """
    unit, free = space.in_time("joining motions"), space.latents_of(space.whole(transition))
    if space.latents_of(space.whole(count)) <= most:
        return [count]
    latents = space.latents_of(space.whole(count))
    size = -(-(latents + free) // (most + free))
    left = latents - (size - 1) * free
    return [unit * (left // size + (i < left % size)) for i in range(size)]


def _grouped(motion: MotionBatch, space: LatentSpace) -> Latents:
    """Lay the rows that one latent stands for side by side."""
    unit = space.in_time("joining motions")
    values = motion.features.unflatten(1, (-1, unit)).flatten(2)
    return Latents(space.latents_of(motion.lengths), motion.lengths, values=values)


def _rows(groups: Latents, space: LatentSpace) -> MotionBatch:
    """Lay rows behind each other again."""
    return MotionBatch(groups.content.unflatten(2, (space.in_time("joining motions"), -1)).flatten(1, 2), groups.frames)


def _take(content: Tensor, index: Int[Tensor, "b n"]) -> Tensor:
    index = index.clamp(0, content.shape[1] - 1)[..., None]
    return content.gather(1, index.expand(-1, -1, content.shape[2]))
