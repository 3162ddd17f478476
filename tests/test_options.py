"""The annotation is the rule: what it allows passes as it is, anything else is one line with key and value."""

from __future__ import annotations

import copy
import json
import math
import pickle
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import FrozenInstanceError, dataclass, replace
from typing import Annotated, Any

import numpy as np
import pytest
from annotated_types import Len

from kinema.options import (
    Count,
    Matches,
    NonNegative,
    OneOf,
    Options,
    Share,
    allowed,
    check,
    check_value,
    checked,
    make,
)


@dataclass(frozen=True)
class Example(Options):
    """Hold one field of each kind."""

    steps: Count = 10
    scale: NonNegative = 1.0
    kind: Annotated[str, OneOf(["slow"], ("fast",))] = "slow"
    exact: bool = False
    span: Annotated[Sequence[Share], Len(2, 2)] = (0.0, 1.0)
    sizes: Annotated[str, Matches(r"\d+(,\d+)*", "numbers with commas")] | Count | None = None


class Layer:
    """Take what an example takes."""

    @checked
    def __init__(self, width: Count, *, example: Example | None = None, **others: Any) -> None:
        self.width, self.example, self.others = width, example, others


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"steps": 2.5}, "Example.steps=2.5: must be a whole number from 1 to 1000000000"),
        ({"steps": 1e3}, "Example.steps=1000.0: must be a whole number"),
        ({"steps": "10"}, 'Example.steps="10": must be a whole number'),
        ({"steps": True}, "Example.steps=true: must be a whole number"),
        ({"steps": None}, "Example.steps=null: must be a whole number"),
        ({"scale": -0.5}, "Example.scale=-0.5: must be a finite number >= 0"),
        ({"scale": math.nan}, "Example.scale=NaN: must be a finite number >= 0"),
        ({"scale": math.inf}, "Example.scale=Infinity: must be a finite number >= 0"),
        ({"scale": "high"}, "Example.scale=high: must be a finite number >= 0"),
        ({"kind": "medium"}, "Example.kind=medium: must be one of slow, fast"),
        ({"exact": "maybe"}, "Example.exact=maybe: must be true or false"),
        ({"exact": 1}, "Example.exact=1: must be true or false"),
        ({"span": (0, 2)}, "Example.span=[0, 2]: must be a list of 2, each a finite number >= 0 and <= 1"),
        ({"span": [0, 0.5, 1]}, "Example.span=[0, 0.5, 1]: must be a list of 2"),
        ({"sizes": "1,x"}, 'Example.sizes="1,x": must be numbers with commas or a whole number from'),
        ({"kind": "\x1b[31m" + "x" * 500}, r'Example.kind="\u001b[31mxxx'),
    ],
)
def test_a_wrong_value_is_one_line(change, message):
    with pytest.raises(ValueError) as raised:  # noqa: PT011  # the whole text is compared
        replace(Example(), **change)
    assert str(raised.value).startswith(message)
    assert len(str(raised.value)) < 250


def test_what_is_right_stays_as_it_is():
    made = Example(steps=1, scale=2, span=[0, 1], sizes="3,4")
    assert (made.scale, made.span) == (2, [0, 1])
    assert isinstance(made.scale, int)
    assert pickle.loads(pickle.dumps(made)) == copy.deepcopy(made) == made
    with pytest.raises(FrozenInstanceError):
        made.steps = 3


RIGHT = {
    "steps": [np.int64(3), np.int32(3), np.uint8(3)],
    "scale": [np.float64(0.5), np.float32(0.5), np.int64(2)],
    "exact": [np.True_, np.False_],
    "kind": [np.str_("fast")],
    "span": [[np.float64(0), np.int64(1)], (np.float32(0), 1.0)],
    "sizes": [np.int64(3)],
}
WRONG = {
    "steps": [np.int64(0), np.float64(2), np.True_],
    "scale": [np.float32(-1), np.float64("nan"), np.float32("inf"), np.True_],
    "exact": [np.int64(1)],
    "span": [[np.int64(2), 0.5]],
    "sizes": [np.float64(3)],
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in RIGHT.items() for value in values])
def test_numbers_of_numpy_are_numbers(name, value):
    plain = np.asarray(value).tolist()
    kept = getattr(replace(Example(), **{name: value}), name)
    assert list(kept) == plain if name == "span" else kept == plain
    json.dumps(kept)  # as they are saved with weights
    assert type(Layer(np.int64(3), example=Example()).width) is int


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in WRONG.items() for value in values])
def test_wrong_numbers_of_numpy_are_shown_as_numbers(name, value):
    with pytest.raises(ValueError, match=rf"^Example\.{name}=[\d.\-\[\], ]*(true|NaN|Infinity)?: must be "):
        replace(Example(), **{name: value})


def test_constructors_are_checked_by_position_and_by_name():
    assert Layer(3, example=Example(), more="x").others == {"more": "x"}
    for arguments, options, name in (
        ((0,), {}, "width=0"),
        ((1,), {"example": "x"}, "example=x: must be a Example or null"),
    ):
        with pytest.raises(ValueError, match=rf"Layer\.{name}"):
            Layer(*arguments, **options)
    with pytest.raises(TypeError, match="width"):
        Layer()


def test_a_mapping_is_named_by_its_key():
    assert make(Example, {"steps": 3}, "generator.sampling").steps == 3
    with pytest.raises(ValueError, match=r"generator.sampling.scale=high: must be a finite number >= 0$"):
        make(Example, {"scale": "high"}, "generator.sampling")
    with pytest.raises(ValueError, match=r"sampling.size is no option; sampling has exact, kind, scale"):
        make(Example, {"size": 3}, "sampling")
    check(Example, {"unknown": 3}, "sampling")


def test_a_rule_without_words_is_no_rule():
    with pytest.raises(TypeError, match="no words"):
        allowed(Annotated[int, "small"])
    with pytest.raises(ValueError, match=r"^seconds=NaN: must be a finite number$"):
        check_value(math.nan, float, "seconds")


def test_pydantic_is_paid_for_by_what_makes_objects():
    command = "import kinema.options, sys; assert 'pydantic' not in sys.modules"
    subprocess.run([sys.executable, "-c", command], check=True)
