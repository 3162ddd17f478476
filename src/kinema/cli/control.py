"""Do what `kinema edit --hold` asks, and say how near it came."""

from __future__ import annotations

import argparse

from kinema.pipeline import TextToMotion
from kinema.pipeline.editing import parse_frames
from kinema.pipeline.holding import hold
from kinema.types import Motion


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
