"""Classify words for the T2M evaluator: part of speech, overridden by its lists of very important words (VIP).

Source: T2M_EVALUATOR §1, HUMANML3D_DATA §7 (how the published tokens were made).
"""

from __future__ import annotations

import functools
import re
import warnings
from collections.abc import Callable
from typing import Any

from kinema.types import Caption

POS = (
    "VERB", "NOUN", "DET", "ADP", "NUM", "AUX", "PRON", "ADJ", "ADV",
    "Loc_VIP", "Body_VIP", "Obj_VIP", "Act_VIP", "Desc_VIP", "OTHER",
)  # fmt: skip
OTHER = "OTHER"
MAX_WORDS = 20
SENTENCE = MAX_WORDS + 2

VIP = {
    "Loc_VIP": "left right clockwise counterclockwise anticlockwise forward back backward up down straight curve",
    "Body_VIP": "arm chin foot feet face hand mouth leg waist eye knee shoulder thigh",
    "Obj_VIP": "stair dumbbell chair window floor car ball handrail baseball basketball",
    "Act_VIP": "walk run swing pick bring kick put squat throw hop dance jump turn stumble stop sit lift lower raise "
    "wash stand kneel stroll rub bend balance flap jog shuffle lean rotate spin spread climb",
    "Desc_VIP": "slowly carefully fast careful slow quickly happy angry sad happily angrily sadly",
}
# Reversed, so that a word in two lists has the class of the first: Loc, Body, Obj, Act, Desc.
_CLASS_OF_WORD = {word: name for name, words in reversed(VIP.items()) for word in words.split()}
_INDEX = {name: i for i, name in enumerate(POS)}


def pos_index(word: str, tag: str) -> int:
    """Return the class (0..14) of a word of the vocabulary: its VIP class, else its tag, else OTHER."""
    return _INDEX.get(_CLASS_OF_WORD.get(word, tag), _INDEX[OTHER])


def sentence(caption: Caption) -> tuple[list[tuple[str, str]], int]:
    """Return a caption's 22 (word, tag) pairs and their number without padding.

    At most 20 words stand between `sos` and `eos`; `unk` fills up.
    """
    pairs = [_split(token, caption) for token in (caption.tokens or tag_words(caption.text))[:MAX_WORDS]]
    pairs = [("sos", OTHER), *pairs, ("eos", OTHER)]
    return pairs + [("unk", OTHER)] * (SENTENCE - len(pairs)), len(pairs)


def _split(token: str, caption: Caption) -> tuple[str, str]:
    word, slash, tag = token.rpartition("/")
    if not slash:
        raise ValueError(f"token {token!r} of caption {caption.text!r} is not word/POS; write e.g. 'walk/VERB'")
    return word, tag


def tag_words(text: str) -> tuple[str, ...]:
    """Make `word/POS` tokens of a caption that has none, as HumanML3D's were made.

    Tagged and lemmatised by spaCy where it and en_core_web_sm can be loaded; else the bare words with tag OTHER, which
    is said once per process (their VIP classes still count, but inflected words such as "walks" lose theirs).
    """
    if not text.strip():
        raise ValueError("a caption is empty; give it words or leave it out of the corpus")
    text = text.lower().replace("-", "")
    tagger = _tagger()
    if tagger is None:
        return tuple(f"{word}/{OTHER}" for word in re.findall(r"[^\W\d_]+", text))
    return tuple(
        f"{word.lemma_ if word.pos_ in ('NOUN', 'VERB') and word.text != 'left' else word.text}/{word.pos_}"
        for word in tagger(text)
        if word.text.isalpha()
    )


@functools.lru_cache(maxsize=1)
def _tagger() -> Callable[[str], Any] | None:
    """Load spaCy's small English model, or say once that there is none."""
    try:
        import spacy

        return spacy.load("en_core_web_sm")
    except Exception as error:  # absent, without its model, or broken: built for another numpy, it raises ValueError
        reason = "" if isinstance(error, ModuleNotFoundError) else f" (spaCy: {' '.join(str(error).split())[:200]})"
        warnings.warn(
            f"captions without word/POS tokens are split into words without tags{reason}; for the published tagging: "
            "pip install 'kinema[tag]' && python -m spacy download en_core_web_sm",
            stacklevel=2,
        )
        return None
