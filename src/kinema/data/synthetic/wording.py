"""Put a performance into words, with the `word/POS` tokens of HumanML3D: lower case, nouns and verbs as lemmas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from kinema.types import Caption

SUBJECTS = (
    "a person", "a person", "the person", "a man", "the man", "someone", "somebody", "a figure", "a human", "a woman",
)  # fmt: skip
_DOUBLED = frozenset(["run", "jog", "sit", "squat", "hop", "spin", "step", "clap", "get", "put", "trip", "drag"])
_THIRD = {"do": "does", "go": "goes"}

_WORDS = """
DET: a an the both
PRON: someone somebody something it that
NUM: one two three four five ninety
AUX: is
ADP: after in on with to from over above along at around by like of out up down for into as behind
CCONJ: and
PART: away
SCONJ: while
ADJ: straight left right alternating heavy hurt high high single drunk happy sad tired angry old elderly proud scared
 childish exhausted full half quarter slow upper wavy bent several low one little bit other
ADV: forward forwards backward backwards back ahead diagonally clockwise counterclockwise sideways then twice once first
 slowly quickly fast very happily cheerfully sadly tiredly angrily aggressively unsteadily proudly nervously fearfully
 playfully deeply slightly upward underhand overhand halfway almost still
NOUN: person man figure human woman line place spot circle=circles circle zigzag curve arc side=sides side knee=knees
 knee leg foot hand=hands hand arm=arms arm head air step=steps step time=times time row turn degree=degrees dance music
 hip=hips floor ground chair stool seat fist=fists fist front body chest height box object ball cup bottle glass mouth
 sip=sips sip drink sky jack=jacks jack punch kick bow stretch lunge squat tiptoe=tiptoes toe=toes bat club golf
 baseball forehead salute guitar hello pace child way crouch jump
VERB: curve=curving crouch=crouching wave=waving lean=leaning bend=bending bend touch twist=twisting walk=walking
 stretch=stretched stretch raise=raised hold=held stand=standing pick rise jump=jumping cross=crossed strum=strumming
 hang=hanging bounce=bouncing
"""


def _lexicon() -> dict[str, str]:
    """Map every surface word to its token; a word's first entry wins unless a phrase says `word/POS`."""
    tokens: dict[str, str] = {}
    tag = ""
    for item in _WORDS.split():
        if item.endswith(":"):
            tag = item[:-1]
            continue
        lemma, _, surface = item.partition("=")
        tokens.setdefault(surface or lemma, f"{lemma}/{tag}")
    return tokens


LEXICON = _lexicon()


def third(verb: str) -> str:
    """Inflect a verb for he, she, it."""
    if verb in _THIRD:
        return _THIRD[verb]
    if verb.endswith(("s", "x", "z", "ch", "sh")):
        return verb + "es"
    return verb[:-1] + "ies" if verb.endswith("y") and verb[-2] not in "aeiou" else verb + "s"


def gerund(verb: str) -> str:
    """Inflect a verb for what is going on."""
    if verb in _DOUBLED:
        return verb + verb[-1] + "ing"
    return verb[:-1] + "ing" if verb.endswith("e") and not verb.endswith("ee") else verb + "ing"


def fill(template: str, words: Mapping[str, Sequence[str]], rng: np.random.Generator) -> str:
    """Replace slots by one of their synonyms until none is left; an unknown slot is empty."""
    while "{" in template:
        before, _, rest = template.partition("{")
        slot, _, after = rest.partition("}")
        options = words.get(slot, ("",))
        template = before + options[int(rng.integers(len(options)))] + after
    return template


def annotate(phrase: str, progressive: bool) -> tuple[str, list[str]]:
    """Inflect the verbs that `*` marks and look up the other words; gives the text and its tokens."""
    text: list[str] = []
    tokens: list[str] = []
    auxiliary = progressive
    for word in phrase.split():
        if word == ",":
            text[-1] += ","
            continue
        if not word.startswith("*"):
            text.append(word)
            tokens.append(LEXICON[word])
            continue
        verb = word[1:]
        if auxiliary:
            text.append("is")
            tokens.append("is/AUX")
            auxiliary = False
        text.append(gerund(verb) if progressive else third(verb))
        tokens.append(f"{verb}/VERB")
    return " ".join(text), tokens


def tell(
    parts: Sequence[tuple[Sequence[str], Mapping[str, Sequence[str]]]], manner: Sequence[str], rng: np.random.Generator
) -> Caption:
    """Make one caption of the phrases and words of each part of a performance, and of its manner."""
    pick = lambda options: options[rng.integers(len(options))]  # noqa: E731
    phrases = [fill(pick(phrases), words, rng) for phrases, words in parts]
    joint = pick((" and then ", " , then ", " and after that "))
    said, how = joint.join(phrases), pick(tuple(manner))
    progressive = bool(rng.random() < 0.3)
    template = pick(("{subject} {said} {how}",) * 3 + (("{how} , {subject} {said}",) if how else ()))
    text, tokens = annotate(template.format(subject=pick(SUBJECTS), said=said, how=how), progressive)
    return Caption(text, tuple(tokens))
