"""Do what `kinema edit --hold`, `kinema generate --path` and `--chain` ask, and say how near it came."""

from __future__ import annotations

import argparse
from dataclasses import replace

from kinema.motion.seams import Stretch, seams
from kinema.motion.skeleton import Skeleton, get_skeleton
from kinema.motion.waypoints import Waypoints, read_waypoints
from kinema.pipeline import TextToMotion
from kinema.pipeline.arguments import frame_counts
from kinema.pipeline.chaining import TRANSITION, shared_out
from kinema.pipeline.editing import parse_frames, strayed
from kinema.pipeline.following import Followed, carried, follow
from kinema.pipeline.holding import hold
from kinema.pipeline.requests import Take, frames_of
from kinema.types import Motion

LONGEST = 20000
"""Frames that a chained motion may have."""
FASTEST = 12.5
"""Metres per second that a person runs at most: a way that is faster has other units or columns."""

NOTED = 1.0
"""Centimetres of a kept joint that are said."""


def hold_frames(model: TextToMotion, motion: Motion, options: argparse.Namespace) -> Motion:
    """Regenerate everything but some frames, and say where these stand."""
    for option, given in (("--parts", options.parts is not None), ("--raw", options.raw)):
        if given:
            raise ValueError(f"--hold keeps whole frames in their places; leave {option} out, or give --keep instead")
    blend = {} if options.blend is None else {"blend": options.blend}
    frames = parse_frames(options.hold, len(motion.features), model.skeleton.fps)
    made = hold(model, motion, options.text, frames, seed=options.seed, **blend, **options.set)
    unit = model.tokenizer.space.in_time("keeping a part of a motion")
    latents = f", whole latents of {unit} frames" if unit > 1 else ""
    print(
        f"held      frames {', '.join(map(str, frames))}{latents}: within {100 * made.away:.1f} cm of where they were; "
        f"the root was led by {100 * made.led:.0f} cm and {made.turned:.0f} degrees at most"
    )
    return made.motion


def follow_path(model: TextToMotion, asked: list[Take], options: argparse.Namespace) -> list[Motion]:
    """Generate motion along the way of a file, and say how far from it the roots are."""
    if options.chain or any(take.frames(None, model.skeleton.fps) is not None for take in asked):
        raise ValueError(
            "--path says itself how long a motion is (or --seconds does): leave --chain and lengths of prompts out"
        )
    fps = model.skeleton.fps
    (count,) = frame_counts(options.frames, options.seconds, 1, fps=fps, maximum=model.max_frames)
    way = _way(options.path, fps, count, "give --seconds to go it slower, or")
    if count is None and way.frames(fps) > model.max_frames:
        raise ValueError(
            f"{options.path} takes {way.seconds:.1f} s, the longest motion is {model.max_frames / fps:.1f} s; give "
            "--seconds to go it faster, or a shorter path"
        )
    texts, seeds = [take.prompt.text for take in asked], [take.seed for take in asked]
    made = follow(model, texts, way, count, seed=seeds, batch_size=options.batch_size, **options.set)
    _tell_path(way, made)
    return made.motions


def take_along(motion: Motion, path: str) -> Motion:
    """Take a motion as it is along the way of a file, in the way's own time, and say how far from it the root is."""
    skeleton = get_skeleton(motion.skeleton)
    way = _way(path, skeleton.fps, None, "give its rows a time, or")
    made = carried([motion], way, skeleton)
    _tell_path(way, made)
    return made.motions[0]


def _way(path: str, fps: float, count: int | None, fix: str) -> Waypoints:
    """Read a way, say how it was understood, and refuse one that nobody could go in so many frames (None: its own)."""
    way = read_waypoints(path, fps)
    pace = way.length * fps / max(way.frames(fps) - 1 if count is None else count - 1, 1)
    print(f"read {path}: {way.note}; {way.length:.1f} m at {pace:.2g} m/s")
    if pace > FASTEST:
        raise ValueError(
            f"{path} goes {way.length:.1f} m at {pace:.0f} m/s, and nobody runs faster than {FASTEST:g}: {fix} write "
            "it in metres"
        )
    return way


def _tell_path(way: Waypoints, made: Followed) -> None:
    how = "known to the network" if made.strides is None else f"strides x {', '.join(f'{s:.2f}' for s in made.strides)}"
    print(
        f"path      {way.length:.1f} m: the root is {100 * made.away:.1f} cm from it on average, frame by frame; {how}"
    )


def chained(model: TextToMotion, asked: list[Take], options: argparse.Namespace) -> Motion:
    """Join texts to one motion; one that is to be longer than the model's longest motion is shared out to parts."""
    fps, texts = model.skeleton.fps, [take.prompt.text for take in asked]
    (usual,) = frame_counts(options.frames, options.seconds, 1, fps=fps, maximum=LONGEST, fix="")
    counts = frames_of(asked, usual, fps=fps, maximum=LONGEST, fix="")
    parts: list[tuple[str, int | None]] = []
    for text, count in zip(texts, counts, strict=True):
        space, most = model.generator.space, model.max_frames
        shares = [None] if count is None else shared_out(count, space, TRANSITION, space.latents_of(most))
        parts += [(text, share) for share in shares]
    if len(parts) > len(texts):
        print(f"parts     {len(parts)} of {', '.join(str(share) for _, share in parts)} frames")
    said, sizes = [text for text, _ in parts], [share for _, share in parts]
    made = model.chain(said, sizes, transition=TRANSITION, seed=options.seed, **options.set)
    return replace(made, text="; ".join(texts))


def tell_strayed(motion: Motion, skeleton: Skeleton) -> None:
    """Say how far an edit will move what it keeps of a body with bones of its own."""
    centimetres = 100 * skeleton.meters * strayed(motion, skeleton)
    if centimetres >= NOTED:
        print(f"note      kept joints get {skeleton.name}'s bones: up to {centimetres:.0f} cm from the file's places")


def tell_seams(motion: Motion, skeleton: Skeleton) -> None:
    """Say of each generated transition how it differs from the rest of the motion."""
    if motion.kept is None:
        return
    found, rest = seams(motion.joints, motion.kept, skeleton, motion.fps)

    def said(one: Stretch) -> str:
        return f"largest step {100 * one.step:.0f} cm, peak jerk {one.jerk:.0f} m/s3, skating {one.skating:.0%}"

    for seam in found:
        print(f"seam      {seam.start / motion.fps:.1f} s (frames {seam.start}:{seam.end}): {said(seam)}")
    print(f"elsewhere {said(rest)}")
