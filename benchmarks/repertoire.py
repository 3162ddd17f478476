"""Measure how often a packed model's note is right: `python benchmarks/repertoire.py MODEL`, with its corpus at hand.

Captions of test clips and prompts as people type them should pass; sentences that the threshold was not chosen on
should be told.
"""

from __future__ import annotations

import sys
from pathlib import Path

from kinema.data.store import PackedStore
from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.repertoires import captions_of, directions_of, foreign_sentences
from kinema.pipeline.models import DEFAULT, find_model
from kinema.pipeline.repertoire import Repertoire
from kinema.text.encoders import build_text_encoder

TYPED = """
a person waves with the left hand; a person walks forward; a man jumps; a person dances; a person sits down; a
person stands up; someone runs in a circle; walk; run; jump; dance; run like an old man; a zombie walks; kick
a ball; a person kicks a ball; a person punches; a person turns left; a person raises the right hand sadly;
raise both hands; someone climbs a ladder; a woman bows; bow; a person lies down on the floor; lie down; a
tired person walks slowly; a person throws a basketball; a man is boxing; someone laughs; drinking a soda;
sneak forward; an angry man walks backwards; wave goodbye; a person does a squat; a person squats; salsa
dancing; a person walks up steps; jogging; a proud woman walks
"""
ELSEWHERE = """
a person plays the guitar; a person does a handstand; someone paints a wall; a man pushes a heavy box; a
person rides a skateboard; a person crawls under a table; someone plays table tennis; a person does sit-ups; a
woman plays the flute; a man catches a fish; a person prays; a person types a message on the phone; someone
saws a plank; a person rolls on the ground; a man milks a cow; a person opens an umbrella; someone flies a
kite; a person sews a button; a person does the splits; a man shakes hands with somebody; a person carries a
baby; a person dives into a pool; the weather is fine today; a cup of coffee; how old is the universe; select
name from users; the train leaves at nine; my favourite colour is green; democracy and freedom; the cake is in
the oven; two plus two is four; an old stone bridge; the lawyer read the contract; bananas are rich in
potassium; a thunderstorm at night; open the file; the price of oil; a kitten plays with wool; snow melts in
spring; elections are held every four years
"""


def sentences(block: str) -> list[str]:
    """Split a block at its semicolons."""
    return " ".join(block.split()).split("; ")


def main() -> None:
    """Print the share of texts that each group would be told of."""
    cfg = compose(["data=open_mocap"])
    if not Path(cfg.data.source).is_dir():
        print(f"skipped: no corpus at {cfg.data.source}; set KINEMA_SHARED")
        return
    known = Repertoire.read(find_model(sys.argv[1] if len(sys.argv) > 1 else DEFAULT))
    assert known is not None
    encoder, store = build_text_encoder("minilm"), PackedStore.open(open_corpus(cfg))
    groups = {
        "training captions": list(captions_of(store, "train")),
        "val captions (chosen on)": list(captions_of(store, "val")),
        "test captions": list(captions_of(store, "test")),
        "as people type them": sentences(TYPED),
        "foreign (chosen on)": foreign_sentences(),
        "foreign, held out": sentences(ELSEWHERE),
    }
    print(f"threshold {known.threshold}")
    for name, texts in groups.items():
        highest = known.similarities(directions_of(texts, encoder)).max(-1).values
        told = highest < known.threshold
        odd = told if "foreign" not in name else ~told
        examples = "; ".join(text for text, one in zip(texts, odd.tolist(), strict=True) if one)
        print(f"{name:26} {len(texts):5}  told {told.float().mean():6.1%}  e.g. {examples[:160]}")


if __name__ == "__main__":
    main()
