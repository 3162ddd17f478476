"""Return a performance a manner: how fast and how big, and in which mood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinema.data.synthetic.plan import Plan
from kinema.data.synthetic.tracks import RAD, Tracks


@dataclass(frozen=True)
class Style:
    """Hold a manner and its words. Angles in degrees, lengths in leg lengths.

    tempo, size: factors of speed and of how far one reaches or steps. lean, head: posture of trunk and head. knees:
    how far the hips sink. out, elbow: of the arms. sway, bounce: how far the hips move sideways and up and down.
    """

    words: tuple[str, ...]
    tempo: float = 1.0
    size: float = 1.0
    lean: float = 0.0
    head: float = 0.0
    knees: float = 0.0
    out: float = 0.0
    elbow: float = 0.0
    sway: float = 0.0
    bounce: float = 0.0


STYLES = {
    "neutral": Style(("",)),
    "slow": Style(("slowly", "very slowly", "at a slow pace"), 0.66, 0.9),
    "fast": Style(("quickly", "fast", "very quickly"), 1.4, 1.1),
    "happy": Style(("happily", "in a happy way", "cheerfully"), 1.15, 1.1, -8, -12, 0, 16, 20, 0.02, 0.035),
    "sad": Style(("sadly", "in a sad way", "with the head hanging down sadly"), 0.8, 0.85, 18, 34),
    "tired": Style(("tiredly", "in a tired way", "like an exhausted person"), 0.72, 0.8, 30, 18, 0.06),
    "angry": Style(("angrily", "in an angry way", "aggressively"), 1.25, 1.1, 14, 4, 0.03, 20, 50),
    "old": Style(("like an old person", "in an elderly way", "as an old person"), 0.68, 0.8, 42, -22, 0.1, 6, 35),
    "drunk": Style(("like a drunk person", "unsteadily", "in a drunk way"), 0.85, 1.0, 6, 8, 0.03, 14, 0, 0.1),
    "proud": Style(("proudly", "in a proud way", "with the chest out proudly"), 0.95, 1.05, -18, -14, -0.01, 14),
    "scared": Style(("nervously", "in a scared way", "fearfully"), 0.95, 0.85, 16, 10, 0.12, 4, 85),
    "childish": Style(("like a child", "playfully", "in a childish way"), 1.15, 1.05, -2, -6, 0, 34, 10, 0.05, 0.05),
}


def apply(style: Style, tracks: Tracks, plan: Plan) -> None:
    """Put a style's posture and rhythm on a performance; its tempo and size were the plan's."""
    on = plan.held(tracks, 0.5, 0.5) if plan.closed else np.ones(tracks.frames)
    tracks.trunk(on, lean=style.lean, hips=0.2)
    tracks.head[:, 0] += style.head * RAD * on
    beat = 2 * np.pi * plan.uniform(0.45, 0.6) * style.tempo * tracks.time
    sway = style.sway * np.sin(beat) * on
    tracks.root[:, 0] += sway * np.cos(tracks.heading)
    tracks.root[:, 2] -= sway * np.sin(tracks.heading)
    tracks.trunk(sway, roll=130)
    tracks.root[:, 1] -= on * (style.knees + style.bounce * (1 - np.cos(4 * beat)))
    # Only arms that hang free take on the style's posture: what a raised arm does is the action's.
    free = on[:, None] * np.clip(1 - np.abs(tracks.arms[:, :, :2]).max(-1) / (60 * RAD), 0, 1)
    tracks.arms[:, :, 1] += style.out * RAD * free
    tracks.arms[:, :, 4] += style.elbow * RAD * free


def enliven(tracks: Tracks, plan: Plan) -> None:
    """Add the small slow movements of somebody who is alive."""
    waves = 2 * np.pi * (plan.rng.uniform(0.1, 0.6, 14) * tracks.time[:, None] + plan.rng.uniform(0, 1, 14))
    drift = np.sin(waves) * plan.rng.uniform(0.3, 1.6, 14) * RAD
    posture = plan.rng.normal(0, 2.5, 14) * RAD
    change = drift + posture
    tracks.spine += change[:, :3]
    tracks.head += 1.5 * change[:, 3:6]
    tracks.arms[:, :, [0, 1, 3, 4]] += 1.5 * np.abs(change[:, 6:]).reshape(-1, 2, 4) * [1, 1, 1, 1.5]
    tracks.root[:, [0, 2]] += 0.3 * drift[:, :2]
