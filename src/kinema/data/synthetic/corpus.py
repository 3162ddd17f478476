"""Generate a corpus of movements with captions, clip by clip, from a seed and a number."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np
from annotated_types import Interval, Len

from kinema.data.captions import AnnotatedCaption
from kinema.data.catalog import SPLITS, Catalog, Clip
from kinema.data.splitting import split_of
from kinema.data.synthetic import gestures, jumps, locomotion, postures  # noqa: F401 (they register their actions)
from kinema.data.synthetic.bodies import Body, pose, rotation
from kinema.data.synthetic.plan import ACTIONS, LONGEST, Action, Plan
from kinema.data.synthetic.styles import STYLES, apply, enliven
from kinema.data.synthetic.tracks import Tracks
from kinema.data.synthetic.wording import tell
from kinema.motion.skeleton import SKELETONS, get_skeleton
from kinema.options import OneOf, Seed, Share
from kinema.seeds import stream

VERSION = 1
"""Raised when the same seed gives other clips, so that stores made before are not taken for them."""

SEQUENCES = 0.2
"""Share of clips that show two actions, one after the other."""
CAPTIONS = 3
Clips = Annotated[int, Interval(ge=1, le=10**6)]


@dataclass(frozen=True)
class Performance:
    """Hold what one clip shows: its tracks, the captions, and what it is called."""

    tracks: Tracks
    captions: list[AnnotatedCaption]
    action: str
    style: str


def perform(seed: int, index: int, fps: float, *, tags: bool = True) -> Performance:
    """Draw clip `index` of the corpus `seed`: what is done, how, and what is said of it.

    `tags`: some captions are about one of two actions only and carry its seconds.
    """
    rng = stream(seed, index)
    mirrored = bool(rng.random() < 0.5)
    style = str(rng.choice(list(STYLES))) if rng.random() < 0.62 else "neutral"
    sequence = bool(rng.random() < SEQUENCES)
    chosen = _pick(rng, 2 if sequence else 1)
    plans = [
        Plan(rng, fps, STYLES[style].tempo, STYLES[style].size, closed=sequence, longest=4.8 if sequence else LONGEST)
        for _ in chosen
    ]
    played = [play(a, plan, style, mirrored) for a, plan in zip(chosen, plans, strict=True)]
    overlap = round(0.3 * fps)
    tracks = played[0].then(played[1], overlap) if sequence else played[0]
    enliven(tracks, plans[0])
    told = [(a.phrases, plan.words) for a, plan in zip(chosen, plans, strict=True)]
    manner = STYLES[style].words
    captions = [AnnotatedCaption(tell(told, manner, rng)) for _ in range(CAPTIONS)]
    if sequence and tags and rng.random() < 0.6:
        border, end = (played[0].frames - overlap / 2) / fps, (tracks.frames - 1) / fps
        part = int(rng.integers(2))
        span = [(0.0, round(border, 2)), (round(border, 2), round(end, 2))][part]
        captions[-1] = AnnotatedCaption(tell(told[part : part + 1], manner, rng), *span)
    return Performance(tracks, captions, "+".join(a.name for a in chosen), style)


def _pick(rng: np.random.Generator, count: int) -> list[Action]:
    """Draw different actions; two must both be such that they start and end standing."""
    usable = [a for a in ACTIONS.values() if count == 1 or a.joins]
    return [usable[i] for i in rng.choice(len(usable), count, replace=False)]


def play(action: Action, plan: Plan, style: str, mirrored: bool) -> Tracks:
    """Perform an action in a style, on the drawn side, and name the sides in the plan's words."""
    tracks = action.perform(plan)
    apply(STYLES[style], tracks, plan)
    sides, turns = ("left", "right"), ("counterclockwise", "clockwise")
    one = -1 if mirrored else 1
    plan.words |= dict(zip(("side", "other"), [(w,) for w in sides[::one]], strict=True))
    plan.words |= dict(zip(("turn", "counter"), [(w,) for w in turns[::one]], strict=True))
    return tracks.mirrored() if mirrored else tracks


def synthetic_joints(seed: int, index: int, skeleton: str) -> np.ndarray:
    """Return the joints (frames, joints, 3), float32, of clip `index` of the corpus `seed`, in the skeleton's unit.

    Body, place and facing are the clip's own.
    """
    kind = get_skeleton(skeleton)
    tracks = perform(seed, index, kind.fps, tags=skeleton == "humanml3d").tracks
    rng = stream(seed, index, 1)
    body = Body.average(skeleton).varied(rng)
    turned = rotation(1, rng.uniform(-np.pi, np.pi))
    place = rng.normal(0, 1, 3) * [1, 0, 1] * body.leg
    return (pose(body, tracks) @ turned.T + place).astype(np.float32)


def synthetic_clips(
    *,
    size: int = 512,
    seed: int = 0,
    skeleton: str = "humanml3d",
    splits: Sequence[float] = (0.8, 0.1, 0.1),
) -> Iterator[Clip]:
    """Generate a corpus of moving, described people, split by split; clip i depends on (seed, i) only.

    Every clip has 3 captions and the fields `action` and `style`. KIT clips have no time-tagged captions, as in
    KIT-ML. Raises ValueError for a size below 1, or shares that are negative or don't add up to 1.
    """
    kind = get_skeleton(skeleton)
    if size < 1:
        raise ValueError(f"size {size} of the synthetic corpus must be at least 1 clip")
    if len(splits) != 3 or min(splits) < 0 or abs(sum(splits) - 1) > 1e-6:
        raise ValueError(f"splits {splits} must be three shares (train, val, test) that add up to 1")
    shares = [split_of(i, splits) for i in range(size)]
    for split in SPLITS:
        for index in (i for i in range(size) if shares[i] == split):
            shown = perform(seed, index, kind.fps, tags=skeleton == "humanml3d")
            yield Clip(
                f"synthetic_{index:06d}",
                split,
                shown.captions,
                {"action": shown.action, "style": shown.style},
                joints=partial(synthetic_joints, seed, index, skeleton),
                made_from=f"synthetic {VERSION} {seed} {index} {skeleton}",
            )


def synthetic_catalog(
    *,
    size: Clips = 512,
    seed: Seed = 0,
    skeleton: Annotated[str, OneOf(SKELETONS)] = "humanml3d",
    splits: Annotated[Sequence[Share], Len(3, 3)] = (0.8, 0.1, 0.1),
) -> Catalog:
    """Generate a corpus as a catalog, the form that `prepare` reads."""
    return Catalog(list(synthetic_clips(size=size, seed=seed, skeleton=skeleton, splits=splits)))
