"""Actions of the arms and the head, standing on one spot."""

from __future__ import annotations

import numpy as np

from kinema.data.synthetic.plan import Plan, action
from kinema.data.synthetic.postures import both_arms
from kinema.data.synthetic.tracks import RAD, Tracks, pulse, smooth

HANDS = {
    "one": ("the {side} hand", "the {side} arm"),
    "both": ("both hands", "both arms"),
}


def _hands(plan: Plan) -> tuple[int, ...]:
    """Choose the left or both hands and put it in the slot `hand`."""
    return (0,) if plan.choose("hand", HANDS) == "one" else (0, 1)


@action("*wave {hand} {height}", "*wave with {hand} {height}", "*say hello by waving {hand} {height}")
def wave(plan: Plan) -> Tracks:
    hands = _hands(plan)
    high = plan.choose("height", {True: ("above the head", "high in the air"), False: ("",)})
    tracks, up = plan.during(0.6, 0.6)
    beat = np.sin(2 * np.pi * plan.uniform(1.2, 1.6) * plan.tempo * tracks.time)
    for side in hands:
        out, elbow = (145 + 14 * beat, 25 + 15 * beat) if high else (62, 112 + 27 * beat)
        tracks.arm(side, up, out=out, twist=90, elbow=elbow)
    return tracks


@action("*punch {how} {count}", "*throw a punch {how} {count}", "*box {how} {count}")
def punch(plan: Plan) -> Tracks:
    how = plan.choose(
        "how",
        {
            "one": ("with the {side} fist", "with the {side} hand"),
            "alternating": ("with alternating fists", "with the left and right fist in turn"),
            "upper": ("upward with the {side} fist", "upward with the {side} hand"),
        },
    )
    count = plan.count(0.9, 5)
    tracks, u, index = plan.repeat(count * (2 if how == "alternating" else 1), 0.75 if how == "alternating" else 0.9)
    guard = plan.held(tracks, 0.3, 0.3)
    both_arms(tracks, guard, swing=28, out=14, twist=-22, elbow=128)
    for side in (0, 1):
        mine = index % 2 == side if how == "alternating" else side == 0
        hit = pulse(u, 0.4, 0.45) * mine
        tracks.arm(side, hit, swing=125 if how == "upper" else 90, out=0, twist=0, elbow=75 if how == "upper" else 6)
        tracks.trunk(hit, twist=-28 * (1 - 2 * side), lean=8)
        tracks.hips(hit, z=0.06)
    return tracks


@action(
    "*throw {what} {way} with the {side} hand",
    "*throw {what} {way} with the {side} arm",
    "*toss {what} {way} with the {side} hand",
)
def throw(plan: Plan) -> Tracks:
    plan.words["what"] = ("a ball", "something", "an object")
    over = plan.choose("way", {True: ("overhand", "forward overhand"), False: ("underhand", "forward underhand")})
    tracks, u, _ = plan.repeat(1, 2.2)
    wind, hurl = pulse(np.clip(u / 0.62, 0, 1), 0.5, 0.3), pulse(np.clip((u - 0.42) / 0.58, 0, 1), 0.3, 0.5)
    if over:
        tracks.arm(0, wind, out=88, across=-35, twist=80, elbow=100)
        tracks.trunk(wind, twist=38, lean=-10)
        tracks.arm(0, hurl, swing=75, out=5, across=15, twist=0, elbow=10)
        tracks.trunk(hurl, twist=-30, lean=22)
    else:
        tracks.arm(0, wind, swing=-58, elbow=4)
        tracks.hips(wind, drop=0.12)
        tracks.trunk(wind, lean=28, twist=15)
        tracks.arm(0, hurl, swing=98, elbow=8)
    step = smooth(wind + hurl)
    tracks.foot(1, step, z=0.28)
    tracks.foot(1, np.sin(np.pi * step) ** 2, lift=0.05)
    tracks.hips(step, z=0.12)
    return tracks


@action("*raise {hand} {way} {count}", "*lift {hand} {way} {count}", "*put {hand} up {way} {count}")
def raise_arms(plan: Plan) -> Tracks:
    hands = _hands(plan)
    way = plan.choose(
        "way",
        {
            "front": ("to the front", "in front of the body"),
            "side": ("out to the side", "sideways"),
            "over": ("over the head", "above the head"),
        },
    )
    tracks, u, _ = plan.repeat(plan.count(1.8, 4), 1.8)
    up = pulse(u, 0.35, 0.35)
    for side in hands:
        target = {"front": {"swing": 90, "out": 2}, "side": {"out": 90}, "over": {"swing": 172, "out": 8}}[way]
        tracks.arm(side, up, elbow=5, **target)
    return tracks


@action("*clap {where} {count}", "*clap the hands {where} {count}", "*clap both hands {where} {count}")
def clap(plan: Plan) -> Tracks:
    over = plan.choose("where", {True: ("over the head", "above the head"), False: ("", "in front of the chest")})
    count = plan.count(0.7, 5)
    period, held = 0.55, 0.7
    tracks = plan.stand(2 * held + count * period / plan.tempo + plan.uniform(0.3, 0.8))
    up = plan.held(tracks, 0.5, 0.5)
    phase = np.clip((tracks.time - held) * plan.tempo / period, 0, count)
    apart = 0.5 + 0.5 * np.cos(2 * np.pi * phase)
    for side in (0, 1):
        if over:
            tracks.arm(side, up, swing=17, out=174 - 38 * apart, across=34, twist=80, elbow=27)
        else:
            tracks.arm(side, up, swing=55, out=30, across=3 - 16 * apart, twist=-48 + 30 * apart, elbow=75)
    return tracks


@action(
    "*drink from {what} with the {side} hand {count}",
    "*take {sips} from {what} with the {side} hand",
    "*raise {what} to the mouth with the {side} hand {count}",
)
def drink(plan: Plan) -> Tracks:
    plan.words["what"] = ("a cup", "a bottle", "a glass")
    count = plan.count(2.2, 3)
    plan.words["sips"] = {1: ("a sip", "a drink"), 2: ("two sips",), 3: ("three sips",)}[count]
    tracks, u, _ = plan.repeat(count, 2.2)
    up = pulse(u, 0.35, 0.35)
    held = plan.held(tracks, 0.3, 0.3)
    tracks.arm(0, held, swing=12, elbow=80, twist=-15)
    tracks.arm(0, up, swing=68, out=23, across=8, twist=-26, elbow=121)
    tracks.head[:, 0] -= 18 * RAD * up
    return tracks


@action("*point {way} with the {side} hand", "*point {way} with the {side} arm", "*point the {side} arm {way}")
def point(plan: Plan) -> Tracks:
    way = plan.choose(
        "way",
        {
            "ahead": ("forward", "straight ahead"),
            "side": ("to the {side}", "out to the {side}"),
            "up": ("up", "up at the sky"),
            "down": ("down", "down at the floor"),
        },
    )
    tracks, up = plan.during(0.5, 0.6)
    target = {
        "ahead": {"swing": 88, "out": 0},
        "side": {"out": 88},
        "up": {"swing": 155, "out": 12},
        "down": {"swing": 42, "out": 4},
    }[way]
    tracks.arm(0, up, elbow=3, **target)
    tracks.head[:, {"side": 1}.get(way, 0)] += up * RAD * {"ahead": 0, "side": 40, "up": -28, "down": 28}[way]
    return tracks


@action(
    "*push something forward with {hand} {count}",
    "*push forward with {hand} {count}",
    "*shove something away with {hand} {count}",
)
def push(plan: Plan) -> Tracks:
    hands = _hands(plan)
    tracks, u, _ = plan.repeat(plan.count(1.6, 4), 1.6)
    held, out = plan.held(tracks, 0.4, 0.4), pulse(u, 0.4, 0.45)
    for side in hands:
        tracks.arm(side, held, swing=10, out=22, elbow=115)
        tracks.arm(side, out, swing=80, out=4, elbow=8)
    tracks.trunk(out, lean=24, twist=-15 if len(hands) == 1 else 0)
    tracks.hips(out, z=0.08, drop=0.04)
    return tracks


@action("*circle {hand} {way} {count}", "*swing {hand} {way} in circles {count}", "*rotate {hand} {way} {count}")
def arm_circles(plan: Plan) -> Tracks:
    hands = _hands(plan)
    forward = plan.choose("way", {True: ("forward", "forwards"), False: ("backward", "backwards")})
    tracks, u, _ = plan.repeat(plan.count(1.5, 4), 1.5)
    # Within half a turn of hanging: the same posture, but one that can be blended with another action's.
    angle = (360 * u + 180) % 360 - 180
    rounds = plan.held(tracks, 0.25, 0.25)
    for side in hands:
        tracks.arm(side, rounds, out=16, elbow=8)
        tracks.arms[:, side, 0] += angle * RAD * (-1 if forward else 1)
    return tracks


@action("*look {way}", "*turn the head {way}", "*look {way} while standing still")
def look(plan: Plan) -> Tracks:
    way = plan.choose(
        "way",
        {
            "side": ("to the {side}", "over to the {side}"),
            "both": ("to the {side} and then to the {other}", "first to the {side} and then to the {other}"),
            "up": ("up", "up at the sky"),
            "down": ("down", "down at the floor"),
        },
    )
    tracks, u, index = plan.repeat(2 if way == "both" else 1, 2.0)
    look_at = pulse(u, 0.3, 0.3)
    if way in ("side", "both"):
        turned = look_at * np.where(index == 0, 1, -1)
        tracks.head[:, 1] += 55 * RAD * turned
        tracks.trunk(turned, twist=32, hips=0.1)
    else:
        tracks.head[:, 0] += RAD * look_at * (48 if way == "down" else -42)
        tracks.trunk(look_at, lean=14 if way == "down" else -12)
    return tracks


@action(
    "*scratch the head with the {side} hand", "*put the {side} hand on the head", "*touch the head with the {side} hand"
)
def scratch_head(plan: Plan) -> Tracks:
    tracks, up = plan.during(0.7, 0.7)
    rub = np.sin(2 * np.pi * 2.0 * plan.tempo * tracks.time)
    tracks.arm(0, up, swing=108, out=65, across=16, twist=51, elbow=119 + 6 * rub)
    tracks.head[:, 2] += 10 * RAD * up
    return tracks


@action("*swing {what} to the {other} {count}", "*swing {what} with both hands to the {other} {count}")
def swing_bat(plan: Plan) -> Tracks:
    golf = plan.choose("what", {True: ("a golf club",), False: ("a baseball bat", "a bat")})
    tracks, u, _ = plan.repeat(plan.count(2.4, 3), 2.4)
    wind, hit = pulse(np.clip(u / 0.55, 0, 1), 0.55, 0.35), pulse(np.clip((u - 0.36) / 0.64, 0, 1), 0.3, 0.5)
    held = plan.held(tracks, 0.4, 0.4)
    both_arms(tracks, held, swing=38 if golf else 68, out=2, across=16, twist=-20, elbow=12 if golf else 40)
    tracks.trunk(held, lean=34 if golf else 8)
    tracks.trunk(wind, twist=62)
    tracks.trunk(hit, twist=-62)
    both_arms(tracks, wind + hit, swing=75 if golf else 88)
    return tracks


@action(
    "*salute with the {side} hand",
    "*raise the {side} hand to the forehead and *salute",
    "*give a salute with the {side} hand",
)
def salute(plan: Plan) -> Tracks:
    tracks, up = plan.during(0.4, 0.5)
    tracks.arm(0, up, swing=100, out=77, across=-5, twist=49, elbow=107)
    return tracks


@action("*cross the arms {chest}", "*fold the arms {chest}", "*stand with the arms crossed {chest}")
def cross_arms(plan: Plan) -> Tracks:
    plan.words["chest"] = ("over the chest", "in front of the chest")
    tracks, up = plan.during(0.6, 0.6)
    for side in (0, 1):
        tracks.arm(side, up, swing=47 + 4 * side, out=12, across=25, twist=-67, elbow=71)
    return tracks


@action("*play the guitar {handed}", "*strum a guitar {handed}", "*play an air guitar {handed}")
def play_guitar(plan: Plan) -> Tracks:
    plan.words["handed"] = ("with the {side} hand", "by strumming with the {side} hand")
    tracks, up = plan.during(0.6, 0.6)
    strum = np.sin(2 * np.pi * plan.uniform(1.4, 1.8) * plan.tempo * tracks.time)
    tracks.arm(0, up, swing=12, out=25, twist=-55 + 12 * strum, elbow=82 + 14 * strum)
    tracks.arm(1, up, swing=30, out=38, twist=25, elbow=92)
    tracks.trunk(up * strum, lean=4)
    return tracks
