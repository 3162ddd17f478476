"""Read caption lines and mirror what they say (HUMANML3D_DATA §7)."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from kinema.types import Caption


@dataclass(frozen=True)
class AnnotatedCaption:
    """Hold a caption and the seconds it is about; 0 and 0 stand for the whole clip."""

    caption: Caption
    start: float = 0.0
    end: float = 0.0

    @property
    def tagged(self) -> bool:
        """Tell whether the caption is about a part of the clip."""
        return not (self.start == 0.0 and self.end == 0.0)

    def mirrored(self) -> AnnotatedCaption:
        """Swap the sides in text and tokens."""
        tokens = swap_sides(" ".join(self.caption.tokens)).split()
        return AnnotatedCaption(Caption(swap_sides(self.caption.text), tuple(tokens)), self.start, self.end)


def parse_line(line: str) -> AnnotatedCaption:
    """Read `caption#word/POS word/POS ...#start#end`; a bare caption, or one with tokens only, is about the whole clip.

    A `#` that stands in a caption is text, whether tokens follow or not. Tokens of which one has no tag are left out:
    they are made anew of the caption. Raises ValueError for an empty caption, three fields, times that are no numbers,
    negative or infinite, and what may be a caption with numbers behind `#` as well as one with times.
    """
    text, tokens, start, end = _fields(line.strip())
    if not text.strip():
        raise ValueError(f"caption line {line.strip()!r} has no caption before the first `#`")
    found = Caption(text.strip(), tuple(tokens.split()) if untagged(tokens) is None else ())
    return AnnotatedCaption(found, _seconds(start, line), _seconds(end, line))


def parse_captions(text: str) -> list[AnnotatedCaption]:
    """Read a caption file, one caption a line; blank lines are passed over."""
    return [parse_line(line) for line in text.splitlines() if line.strip()]


def tokens_of(line: str) -> str:
    """Return what stands in a line's field for tokens, tagged or not."""
    return _fields(line.strip())[1]


def untagged(tokens: str) -> str | None:
    """Return the first token without a tag, None where all have one."""
    return next((token for token in tokens.split() if "/" not in token), None)


def _fields(line: str) -> tuple[str, str, str, str]:
    """Split a line into caption, tokens, start and end; every `#` that separates no such field is the caption's."""
    parts = line.rsplit("#", 3)
    are_tokens = [untagged(part) is None for part in parts]
    are_times = len(parts) > 2 and _number(parts[-2]) and _number(parts[-1])
    if len(parts) == 4 and (are_times or are_tokens[1]):
        if not are_tokens[1] and any(part[-1:].isspace() for part in parts[:3]):
            raise ValueError(f"caption line {line!r} may end in text or in times; write `caption##0#0` if it is text")
        return parts[0], parts[1], parts[2], parts[3]
    if len(parts) == 3 and (are_times or any(are_tokens[1:])):
        raise ValueError(f"caption line {line!r} has three fields; write `caption#tokens#start#end`")
    if len(parts) == 2 and are_tokens[1]:
        return parts[0], parts[1], "0", "0"
    return line, "", "0", "0"


def _number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _seconds(text: str, line: str) -> float:
    """Read a time tag; the official files write `nan` for 0."""
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"time tag {text!r} of caption line {line.strip()!r} is no number of seconds") from None
    if math.isnan(value):
        return 0.0
    if value < 0 or math.isinf(value):
        raise ValueError(f"time tag {text!r} of caption line {line.strip()!r} must be finite and not negative")
    return value


# One pass over the text, so that what was swapped is never swapped back. The optional `/POS` lets the same pattern
# see "counter clockwise" in a token string, "counter/NOUN clockwise/NOUN".
_SIDES = re.compile(
    r"\b(?:(?P<turn>(?P<against>(?:counter|anti)(?:/\w+)?[ -]?)?clockwise)"
    r"|(?P<side>left|right)(?P<rest>(?:hand|foot|leg|arm|side)(?:ed|er|s)?|wards?|most)?)\b",
    re.IGNORECASE,
)


def swap_sides(text: str) -> str:
    """Swap left and right, clockwise and counterclockwise, as whole words and all at once.

    `anticlockwise` becomes `clockwise`, which becomes `counterclockwise`. Compounds follow: left-handed, leftward.
    Works on token strings (`left/ADJ foot/NOUN`) as on prose.
    """
    return _SIDES.sub(_swap, text)


def _swap(match: re.Match[str]) -> str:
    found = match[0]
    if match["turn"]:
        return _like(found, "clockwise" if match["against"] else "counterclockwise")
    other = "right" if match["side"].lower() == "left" else "left"
    return _like(match["side"], other) + (match["rest"] or "")


def _like(model: str, word: str) -> str:
    """Write a word in the case of its model."""
    if model.isupper():
        return word.upper()
    return word.capitalize() if model[0].isupper() else word
