"""Actions that take steps: walking and its relatives, turning, dancing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kinema.data.synthetic.gait import Gait, arc, step, straight, turn, weave
from kinema.data.synthetic.plan import Plan, action
from kinema.data.synthetic.tracks import RAD, Tracks, pulse

FORWARD = ("forward", "straight ahead", "in a straight line", "straight forward")
BACKWARD = ("backward", "backwards", "back")
CIRCLE = ("in a circle {turn}", "{turn} in a circle", "around in a {turn} circle")
CURVE = ("in a curve to the {side}", "forward while curving to the {side}", "along an arc to the {side}")
WEAVE = ("in a zigzag", "from side to side in a zigzag line", "in a wavy line")
DIAGONAL = ("diagonally to the {side}", "forward and to the {side}", "diagonally forward to the {side}")
IN_PLACE = ("in place", "on the spot")


def _travel(plan: Plan, gait: Gait, options: dict[str, tuple[str, ...]], seconds: float) -> tuple[Tracks, np.ndarray]:
    """Choose a path among the options, put it in words, and step along it."""
    if plan.longest < 6:
        options = {k: v for k, v in options.items() if k not in ("circle", "weave")}
    chosen = plan.choose("path", options)
    radius = plan.uniform(1.0, 1.4)
    if chosen == "backward":
        gait = replace(gait, heel=8 * RAD, stride=0.7 * gait.stride)
    if chosen == "in place":
        gait = replace(gait, stride=0.0)
    paths = {
        "forward": straight(0),
        "backward": straight(np.pi),
        "in place": straight(0),
        "circle": arc(radius),
        "curve": arc(2.2 * radius),
        "weave": weave(4.0, 50 * RAD),
        "diagonal": straight(40 * RAD),
    }
    round_trip = 2 * np.pi * radius / max(gait.stride * gait.cadence * plan.tempo * plan.size, 0.1)
    wanted = {"circle": 1.1 * round_trip, "weave": max(seconds, 5.0)}.get(chosen, seconds)
    return step(plan, gait, paths[chosen], seconds=wanted)


@action("*walk {path}", "*walk {path}", "*take several steps {path}", "*stroll {path}")
def walk(plan: Plan) -> Tracks:
    paths = {
        "forward": FORWARD,
        "backward": BACKWARD,
        "circle": CIRCLE,
        "curve": CURVE,
        "weave": WEAVE,
        "diagonal": DIAGONAL,
    }
    gait = Gait(plan.uniform(0.85, 1.0), plan.uniform(1.3, 1.6), swing=plan.uniform(18, 32) * RAD)
    return _travel(plan, gait, paths, plan.uniform(2.3, 7))[0]


@action("*run {path}", "*run {path}", "*jog {path}", joins=False)
def run(plan: Plan) -> Tracks:
    paths = {"forward": FORWARD, "circle": CIRCLE, "curve": CURVE, "in place": IN_PLACE}
    gait = Gait(
        plan.uniform(1.3, 1.45), plan.uniform(2.1, 2.4), 0.36, lift=0.2, heel=60 * RAD, swing=45 * RAD,
        elbow=75 * RAD, bounce=0.035, height=0.95,
    )  # fmt: skip
    tracks, _ = _travel(plan, gait, paths, plan.uniform(2.2, 5))
    tracks.trunk(np.ones(tracks.frames), lean=14)
    return tracks


@action(
    "*march {path} and *lift the knees high",
    "*march {path}",
    "*step {path} with high knees",
    "*raise the knees one after the other {path}",
)
def march(plan: Plan) -> Tracks:
    gait = Gait(plan.uniform(0.75, 0.95), 0.9, 0.6, lift=0.38, heel=10 * RAD, swing=40 * RAD, elbow=45 * RAD)
    return _travel(plan, gait, {"in place": IN_PLACE, "forward": FORWARD}, plan.uniform(2.5, 6))[0]


@action("*sneak {path}", "*sneak {path} in a crouch", "*creep {path} with bent knees")
def sneak(plan: Plan) -> Tracks:
    gait = Gait(
        plan.uniform(0.55, 0.7), 1.1, 0.66, lift=0.16, heel=20 * RAD, swing=10 * RAD, elbow=75 * RAD, height=0.74
    )
    tracks, _ = _travel(plan, gait, {"forward": FORWARD, "backward": BACKWARD, "curve": CURVE}, plan.uniform(3, 7))
    rise = plan.held(tracks, 0.5, 0.5) if plan.closed else np.ones(tracks.frames)
    tracks.trunk(rise, lean=42)
    tracks.head[:, 0] -= 25 * RAD * rise
    return tracks


@action("*tiptoe {path}", "*walk {path} on tiptoes", "*go {path} on the toes")
def tiptoe(plan: Plan) -> Tracks:
    gait = Gait(plan.uniform(0.9, 1.1), 0.8, 0.62, lift=0.1, heel=10 * RAD, swing=6 * RAD)
    tracks, _ = _travel(plan, gait, {"forward": FORWARD, "backward": BACKWARD}, plan.uniform(2.5, 6))
    rise = plan.held(tracks, 0.4, 0.4) if plan.closed else np.ones(tracks.frames)
    for side in (0, 1):
        tracks.feet[:, side, 4] += rise * (42 * RAD - 0.7 * tracks.feet[:, side, 4])
        tracks.arm(side, rise, out=38, elbow=25)
    tracks.hips(rise, drop=-0.1)
    return tracks


@action(
    "*limp {path} on the {side} leg",
    "*limp {path} with a hurt {side} foot",
    "*drag the {side} leg and *limp {path}",
)
def limp(plan: Plan) -> Tracks:
    gait = Gait(plan.uniform(0.7, 0.85), 0.95, 0.64, lift=0.05, heel=18 * RAD, swing=14 * RAD)
    tracks, phase = _travel(plan, gait, {"forward": FORWARD, "circle": CIRCLE}, plan.uniform(3, 7))
    hurt = pulse(np.clip(np.mod(phase, 1) / gait.stance, 0, 1), 0.4, 0.4)
    tracks.hips(hurt, drop=0.09)
    tracks.trunk(hurt, lean=8, roll=16)
    tracks.arm(1, hurt, out=32)
    return tracks


@action("*stumble {path}", "*walk {path} and *trip", "*trip while walking {path} and almost *fall", joins=False)
def stumble(plan: Plan) -> Tracks:
    gait = Gait(plan.uniform(0.9, 1.0), 1.4)
    tracks, _ = _travel(plan, gait, {"forward": FORWARD, "curve": CURVE}, plan.uniform(3, 6))
    middle = tracks.time[-1] * plan.uniform(0.4, 0.6)
    trip = pulse(np.clip((tracks.time - middle) / 1.1 + 0.5, 0, 1), 0.35, 0.6)
    tracks.trunk(trip, lean=48, roll=10)
    tracks.hips(trip, drop=0.14)
    for side in (0, 1):
        tracks.arm(side, trip, swing=85, out=35, elbow=25)
    return tracks


@action(
    "*take {steps} to the {side}",
    "*sidestep to the {side} {count}",
    "*step sideways to the {side} {count}",
)
def sidestep(plan: Plan) -> Tracks:
    gait = Gait(plan.uniform(0.8, 0.95), plan.uniform(0.5, 0.65), 0.6, lift=0.06, heel=8 * RAD, swing=3 * RAD)
    count = 1 + plan.count(1.0 / gait.cadence, 4)
    names = {2: "two", 3: "three", 4: "four", 5: "five"}
    plan.words["steps"] = (f"{names[count]} side steps", f"{names[count]} steps sideways")
    plan.words["count"] = (f"{names[count]} times",) if count > 2 else ("twice", "two times")
    return step(plan, gait, straight(np.pi / 2), cycles=count)[0]


@action(
    "*turn {angle} to the {side}",
    "*turn {angle} {turn}",
    "*rotate {angle} {turn} on the spot",
)
def turn_around(plan: Plan) -> Tracks:
    quarters = plan.choose(
        "angle", {1: ("a quarter turn", "ninety degrees", "by ninety degrees"), 2: ("around", "halfway around")}
    )
    gait = Gait(plan.uniform(1.0, 1.2), 1.0, 0.6, lift=0.06, heel=12 * RAD, swing=6 * RAD)
    return step(plan, gait, turn(quarters * 90 * RAD * plan.uniform(0.95, 1.05)), cycles=1 + quarters)[0]


@action(
    "*spin {turn} {count}{arms}",
    "*twirl around {turn} {count}{arms}",
    "*make a full turn {turn} {count}{arms}",
)
def spin(plan: Plan) -> Tracks:
    count = plan.count(2.6, 2)
    wide = plan.choose(
        "arms", {False: ("",), True: (" with both arms out", " with the arms stretched out to the sides")}
    )
    gait = Gait(plan.uniform(1.5, 1.7), 1.0, 0.56, lift=0.07, heel=18 * RAD, swing=0.0)
    tracks, _ = step(plan, gait, turn(count * 360 * RAD), cycles=4 * count)
    if wide:
        held = plan.held(tracks, 0.5, 0.5)
        for side in (0, 1):
            tracks.arm(side, held, out=85, elbow=8)
    return tracks


@action("*dance {moves}", "*dance {moves} to music", "*do a dance {moves}")
def dance(plan: Plan) -> Tracks:
    moves = plan.choose(
        "moves",
        {
            "arms up": ("with both arms in the air", "and *wave both arms over the head"),
            "twist": ("and *twist the hips", "with twisting hips"),
            "sway": ("and *sway from side to side", "from side to side"),
            "bounce": ("and *bounce up and down", "with bouncing knees"),
        },
    )
    gait = Gait(plan.uniform(1.0, 1.2), 0.5 if moves == "sway" else 0.0, 0.6, lift=0.06, heel=20 * RAD, swing=0.0)
    # One cycle of the sway takes three steps' worth of way, so the hips pass over both feet.
    tracks, phase = step(plan, gait, _sway, seconds=plan.uniform(3, 8))
    on = plan.held(tracks, 0.5, 0.5) if plan.closed else np.ones(tracks.frames)
    beat = on * np.sin(2 * np.pi * phase)
    tracks.trunk(beat, roll=18 if moves == "sway" else 5, twist=35 if moves == "twist" else 5)
    tracks.hips(on * np.sin(2 * np.pi * phase) ** 2, drop=0.13 if moves == "bounce" else 0.02)
    for side, sign in enumerate((1, -1)):
        if moves == "arms up":
            tracks.arm(side, on, out=150 + 18 * sign * beat, elbow=30)
        else:
            tracks.arm(side, on, swing=30 + 25 * sign * beat, out=25, elbow=85)
    return tracks


def _sway(s: np.ndarray, total: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Go from side to side."""
    return 0.45 * np.sin(2 * np.pi * s / 1.5), 0 * s, 0 * s
