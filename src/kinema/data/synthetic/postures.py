"""Actions of the legs and the whole body on one spot: squatting, sitting, kicking, bowing, picking up."""

from __future__ import annotations

import numpy as np

from kinema.data.synthetic.plan import Plan, action
from kinema.data.synthetic.tracks import Tracks, pulse, smooth

SIDES = ((0, 1), (1, -1))
"""Index and sign of the left and the right side."""


def both_arms(tracks: Tracks, amount: np.ndarray, **degrees: float | np.ndarray) -> None:
    """Move both arms towards one posture."""
    for side in (0, 1):
        tracks.arm(side, amount, **degrees)


@action("*squat {arms} {count}", "*do a squat {arms} {count}", "*bend the knees deeply {arms} {count}")
def squat(plan: Plan) -> Tracks:
    arms = plan.choose(
        "arms",
        {
            "front": ("with the arms stretched forward", "with both arms held out in front"),
            "down": ("",),
            "hips": ("with the hands on the hips", "with both hands on the hips"),
        },
    )
    tracks, u, _ = plan.repeat(plan.count(1.9, 4), 1.9)
    down = pulse(u, 0.4, 0.42)
    tracks.hips(down, drop=0.42, z=-0.12)
    tracks.trunk(down, lean=48)
    held = plan.held(tracks, 0.4, 0.4)
    if arms == "front":
        both_arms(tracks, down, swing=105, out=2, elbow=5)
    if arms == "hips":
        both_arms(tracks, held, out=31, swing=0, across=-26, twist=-82, elbow=78)
    return tracks


def _seated(tracks: Tracks, amount: np.ndarray) -> None:
    tracks.hips(amount, drop=0.42, z=-0.5)
    tracks.trunk(4 * amount * (1 - amount), lean=45)
    both_arms(tracks, amount, swing=32, out=8, elbow=62)


@action("*sit down {seat}", "*sit down {seat}", "*take a seat {seat}", joins=False)
def sit_down(plan: Plan) -> Tracks:
    plan.words["seat"] = ("on a chair", "", "on a stool")
    tracks = plan.stand(plan.uniform(2.3, 5) / plan.tempo)
    _seated(tracks, smooth((tracks.time - plan.uniform(0.2, 0.7)) / (1.3 / plan.tempo)))
    return tracks


@action("*stand up {seat}", "*get up {seat}", "*rise {seat}", joins=False)
def stand_up(plan: Plan) -> Tracks:
    plan.words["seat"] = ("from a chair", "from a stool", "from a seat")
    tracks = plan.stand(plan.uniform(2.3, 5) / plan.tempo)
    start = max(0.2, tracks.time[-1] - 1.3 / plan.tempo - plan.uniform(0.3, 1.2))
    _seated(tracks, 1 - smooth((tracks.time - start) / (1.3 / plan.tempo)))
    return tracks


@action("*crouch down", "*crouch down and *stay low", "*duck down low")
def crouch(plan: Plan) -> Tracks:
    tracks, down = plan.during(0.8, 0.9)
    tracks.hips(down, drop=0.5, z=0.02)
    tracks.trunk(down, lean=40)
    for side in (0, 1):
        tracks.foot(side, down, heel=32)
        tracks.arm(side, down, swing=60, out=15, elbow=60)
    return tracks


@action("*kneel down on the {side} knee", "*go down on the {side} knee", "*kneel on the {side} leg")
def kneel(plan: Plan) -> Tracks:
    tracks = plan.stand(plan.uniform(3.2, 6.5) / plan.tempo)
    down = plan.held(tracks, 1.1, 1.1)
    step = smooth(down / 0.6)
    tracks.foot(0, step, z=-0.55, heel=62)
    tracks.foot(0, 4 * step * (1 - step), lift=0.06)
    tracks.hips(down, drop=0.4, z=-0.12)
    tracks.trunk(4 * down * (1 - down), lean=25)
    tracks.arm(1, down, swing=40, elbow=40)
    return tracks


@action(
    "*lunge forward with the {side} leg {count}",
    "*step forward into a lunge with the {side} foot {count}",
    "*do a lunge on the {side} leg {count}",
)
def lunge(plan: Plan) -> Tracks:
    tracks, u, _ = plan.repeat(plan.count(2.2, 3), 2.2)
    out = pulse(u, 0.35, 0.35)
    tracks.foot(0, out, z=0.95)
    tracks.foot(0, np.sin(np.pi * out) ** 2, lift=0.09)
    tracks.foot(1, out, heel=48)
    tracks.hips(out, drop=0.3, z=0.5)
    both_arms(tracks, out, out=20, elbow=35)
    return tracks


@action(
    "*kick {way} with the {side} {limb} {count}",
    "*kick the {side} leg {way} {count}",
    "*give a kick {way} with the {side} {limb} {count}",
)
def kick(plan: Plan) -> Tracks:
    way = plan.choose(
        "way",
        {
            "low": ("low", "low to the ground"),
            "high": ("high", "high up in the air"),
            "side": ("to the side", "sideways", "out to the side"),
            "back": ("backward", "back", "behind"),
        },
    )
    plan.words["limb"] = ("foot", "leg")
    tracks, u, _ = plan.repeat(plan.count(1.5, 3), 1.5)
    raised, thrown = pulse(u, 0.35, 0.4), pulse(np.clip((u - 0.22) / 0.5, 0, 1), 0.42, 0.5)
    tracks.foot(0, raised, lift=0.2, heel=15, x=-0.02)
    reach = {"low": (0, 0.1, 0.55), "high": (0, 0.75, 0.6), "side": (0.7, 0.42, 0), "back": (0, 0.22, -0.75)}[way]
    tracks.foot(0, thrown, x=reach[0], lift=reach[1], z=reach[2], heel={"back": 40, "side": -15}.get(way, -35))
    tracks.hips(raised, drop=0.03, x=-0.1)
    tracks.trunk(thrown, lean={"low": -8, "high": -24, "side": 0, "back": 30}[way], roll=-28 if way == "side" else 0)
    both_arms(tracks, plan.held(tracks, 0.3, 0.3), out=30, swing=20, elbow=55)
    return tracks


@action(
    "*balance on the {other} leg",
    "*stand on the {other} leg with the {side} knee raised",
    "*raise the {side} knee and *hold it",
)
def balance(plan: Plan) -> Tracks:
    tracks, up = plan.during(0.9, 0.9)
    tracks.foot(0, up, lift=plan.uniform(0.4, 0.5), z=0.28, heel=20)
    tracks.hips(up, x=-0.1)
    both_arms(tracks, up, out=plan.uniform(55, 80), elbow=12)
    tracks.trunk(up * np.sin(2 * np.pi * 0.7 * tracks.time), roll=4)
    return tracks


@action(
    "*bow {depth} {count}",
    "*bow {depth} {count}",
    "*take a bow {depth} {count}",
    "*bend forward {depth} to bow {count}",
)
def bow(plan: Plan) -> Tracks:
    depth = plan.choose("depth", {"deep": ("deeply", "low", "very low"), "slight": ("slightly", "a little", "a bit")})
    tracks, u, _ = plan.repeat(plan.count(2.0, 3), 2.0)
    down = pulse(u, 0.35, 0.4)
    tracks.trunk(down, lean=85 if depth == "deep" else 32, hips=0.5)
    tracks.hips(down, z=-0.16 if depth == "deep" else -0.05)
    return tracks


@action(
    "*stretch {way} {count}",
    "*stretch the body {way} {count}",
    "*do a stretch {way} {count}",
)
def stretch(plan: Plan) -> Tracks:
    way = plan.choose(
        "way",
        {
            "side": (
                "to the {side} with the {other} arm over the head",
                "by leaning to the {side} with the {other} arm up",
            ),
            "up": ("upward with both arms and *rise on the toes", "up with both arms on the toes"),
            "toes": ("down and *touch the toes", "by bending down to touch the toes"),
            "twist": ("by twisting to the {side}", "and *twist the upper body to the {side}"),
        },
    )
    tracks, u, _ = plan.repeat(plan.count(2.4, 3), 2.4)
    far = pulse(u, 0.35, 0.35)
    if way == "side":
        tracks.trunk(far, roll=42)
        tracks.arm(1, far, out=165, elbow=20)
        tracks.hips(far, x=-0.08)
    elif way == "up":
        both_arms(tracks, far, swing=172, out=4, elbow=4)
        tracks.hips(far, drop=-0.1)
        for side in (0, 1):
            tracks.foot(side, far, heel=40)
    elif way == "toes":
        tracks.trunk(far, lean=118, hips=0.5)
        tracks.hips(far, z=-0.2, drop=0.02)
        both_arms(tracks, far, swing=70, elbow=5)
    else:
        tracks.trunk(far, twist=65)
        both_arms(tracks, far, swing=80, out=5, elbow=15)
    return tracks


@action(
    "*pick something up {place} {hand}",
    "*bend down and *pick up an object {place} {hand}",
    "*reach down {place} to pick something up {hand}",
)
def pick_up(plan: Plan) -> Tracks:
    place = plan.choose(
        "place", {0: ("from the ground", "from the floor"), 1: ("from the {side}", "on the {side} side")}
    )
    both = plan.choose("hand", {False: ("with the {side} hand",), True: ("with both hands", "with two hands")})
    tracks, u, _ = plan.repeat(1, 3.0)
    down, keep = pulse(np.clip(u / 0.75, 0, 1), 0.45, 0.4), smooth((u - 0.4) / 0.25) * smooth((1 - u) / 0.12)
    tracks.hips(down, drop=0.36, z=-0.1)
    tracks.trunk(down, lean=72, twist=50 * place)
    for side in (0, 1) if both else (0,):
        tracks.arm(side, keep, swing=45, elbow=85)
        tracks.arm(side, down, swing=75, out=4, elbow=8)
    return tracks


@action(
    "*lift {what} {height}",
    "*pick up {what} and *lift it {height}",
    "*bend down and *raise {what} {height}",
)
def lift(plan: Plan) -> Tracks:
    plan.words["what"] = ("a heavy box", "something heavy", "a heavy object")
    high = plan.choose(
        "height", {True: ("over the head", "above the head"), False: ("to the chest", "to chest height")}
    )
    tracks, u, _ = plan.repeat(1, 4.0)
    down = pulse(np.clip(u / 0.55, 0, 1), 0.45, 0.45)
    carried = smooth((u - 0.3) / 0.35) * smooth((1 - u) / 0.15)
    tracks.hips(down, drop=0.44, z=-0.12)
    tracks.trunk(down, lean=62)
    both_arms(tracks, carried, swing=168 if high else 55, out=8, elbow=8 if high else 70)
    both_arms(tracks, down, swing=72, out=6, elbow=10)
    return tracks
