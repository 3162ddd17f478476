"""Say what an option may be where it is declared, and refuse anything else where the object is made.

The annotation of a field of `Options` or of a `checked` constructor's argument is the rule: `guidance: NonNegative`.
Nothing is converted: a bool is no number, a text is none, 2.5 is no whole number; a whole number is a right float.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from functools import cache, wraps
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Concatenate,
    Literal,
    ParamSpec,
    Protocol,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from annotated_types import Ge, Gt, Interval, Le, Len, Lt

WORDS = {int: "a whole number", float: "a finite number", str: "text", bool: "true or false", NoneType: "null"}
P = ParamSpec("P")
Made = TypeVar("Made")

MOST = 10**9
"""What is counted stays below; a larger number is a slip."""
MOST_SHOWN = 60
"""Letters of a wrong value that a message shows."""


@dataclass(frozen=True, init=False)
class OneOf:
    """Allow some names alone."""

    names: tuple[str, ...]

    def __init__(self, *names: Iterable[str]) -> None:
        object.__setattr__(self, "names", tuple(name for several in names for name in several))

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Give pydantic its rule."""
        from pydantic_core import core_schema

        return core_schema.literal_schema(list(self.names))


@dataclass(frozen=True)
class Matches:
    """Allow texts of a form alone: a regular expression, and the words that say it."""

    pattern: str
    words: str

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Give pydantic its rule."""
        from pydantic_core import core_schema

        return core_schema.str_schema(pattern=f"^(?:{self.pattern})$", strict=True)


Positive = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
Share = Annotated[float, Interval(ge=0, le=1)]
OpenShare = Annotated[float, Interval(ge=0, lt=1)]
"""A share that is never all: what is dropped, or kept of an average."""
FullShare = Annotated[float, Interval(gt=0, le=1)]
"""A share that is never nothing."""
Count = Annotated[int, Interval(ge=1, le=MOST)]
Number = Annotated[int, Interval(ge=0, le=MOST)]
Seed = Annotated[int, Interval(ge=0, lt=2**63)]
Size = Annotated[int, Interval(ge=1, le=2**16)]
"""A width, a length or a number of heads; beyond the most, one layer alone takes more than a machine has."""
Classes = Annotated[int, Interval(ge=1, le=2**24)]
"""Entries of a table, such as a codebook or a vocabulary."""
Depth = Annotated[int, Interval(ge=1, le=1000)]
"""Layers one behind the other."""
OptionalDepth = Annotated[int, Interval(ge=0, le=1000)]
"""Layers that there may be none of."""
Threads = Annotated[int, Interval(ge=1, le=4096)]
"""Threads or processes of one machine."""
Steps = Annotated[int, Interval(ge=1, le=10**5)]
"""Steps in which one motion is sampled."""
Levels = Annotated[int, Interval(ge=0, le=10)]
"""How often a length is halved."""
Several = Annotated[int, Interval(ge=2, le=2**16)]
KeptShare = Share | Literal[-1]
"""A share, or -1 for one that is drawn anew for each batch."""


class Options:
    """A frozen dataclass whose fields are checked against their annotations when it is made.

    A subclass with rules of its own writes `__post_init__` and calls this one first.
    """

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            object.__setattr__(self, name, unboxed(value))
        check(type(self), vars(self), type(self).__name__)


def checked(init: Callable[Concatenate[Made, P], None]) -> Callable[Concatenate[Made, P], None]:
    """Check a constructor's arguments against their annotations before it runs."""
    _, *names = inspect.signature(init).parameters

    @wraps(init)
    def checking(self: Made, /, *args: P.args, **kwargs: P.kwargs) -> None:
        own, named = [unboxed(value) for value in args], {key: unboxed(value) for key, value in kwargs.items()}
        check(init, {**dict(zip(names, own, strict=False)), **named}, type(self).__name__)
        init(self, *own, **named)

    return checking


def check(target: Callable[..., Any], values: Mapping[str, Any], at: str) -> None:
    """Check values for a class' or function's arguments; raises ValueError naming `at`.NAME, the value and what may be.

    Names that it doesn't have are not looked at.
    """
    for name, annotation in _annotations(target).items():
        if name in values:
            check_value(values[name], annotation, f"{at}.{name}" if at else name)


def make(kind: Callable[..., Made], values: Mapping[str, Any], at: str) -> Made:
    """Make options of what stands under the key `at`; raises ValueError naming a wrong, unknown or missing key."""
    known = _annotations(kind)
    for name in values:
        if name not in known:
            raise ValueError(f"{at}.{name} is no option; {at} has {', '.join(sorted(known))}")
    check(kind, values, at)
    try:
        return kind(**values)
    except TypeError as error:
        raise ValueError(f"{at}: {error}; it has {', '.join(sorted(known))}") from None


def check_value(value: Any, annotation: Any, key: str) -> None:
    """Check one value against an annotation; raises ValueError naming key, value and what is allowed."""
    from pydantic import ValidationError  # here: what makes no object doesn't pay for it

    try:
        _adapter(annotation).validate_python(unboxed(value))
    except ValidationError:
        raise ValueError(f"{key}={shown(value)}: must be {allowed(annotation)}") from None


def unboxed(value: Any) -> Any:
    """Return NumPy's scalars as Python's own, those in lists and tuples too; anything else as it is."""
    import numpy as np  # here: --help must not pay for it

    if isinstance(value, np.generic):
        return value.item()
    if type(value) in (list, tuple) and any(isinstance(one, np.generic) for one in value):
        return type(value)(map(unboxed, value))
    return value


def allowed(annotation: Any) -> str:
    """Say in words what an annotation allows."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _ruled(arguments[0], arguments[1:])
    if origin in (Union, UnionType):
        return " or ".join(allowed(argument) for argument in arguments)
    if origin is Literal:
        return " or ".join(map(shown, arguments))
    if origin in (list, tuple, Sequence):
        return f"a list, each {allowed(arguments[0])}"
    if origin in (dict, Mapping):
        return "a mapping"
    return WORDS.get(annotation) or f"a {annotation.__name__}"


def shown(value: Any) -> str:
    """Show a value as it is written in a configuration, shortened."""
    value = unboxed(value)
    if isinstance(value, str) and re.fullmatch(r"[A-Za-z_][\w./:-]*", value) and value not in ("null", "true", "false"):
        text = value
    else:
        text = json.dumps(value, default=lambda other: type(other).__name__)
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}..."


def _ruled(base: Any, rules: Sequence[Any]) -> str:
    match rules:
        case [OneOf(names=names)]:
            return f"one of {', '.join(names)}"
        case [Matches(words=words)]:
            return words
        case [Len(min_length=least, max_length=most)]:
            size = f"of {least}" if most == least else f"of at least {least}"
            return allowed(base).replace("a list", f"a list {size}", 1)
        case [Interval(ge=int(least), le=int(most))] if base is int:
            return f"a whole number from {least} to {most}"
        case [Interval() as both]:
            return _ruled(base, list(both))
    return f"{allowed(base)} {' and '.join(map(_bound, rules))}"


def _bound(rule: Any) -> str:
    match rule:
        case Ge(ge=edge):
            return f">= {edge}"
        case Gt(gt=edge):
            return f"> {edge}"
        case Le(le=edge):
            return f"<= {edge}"
        case Lt(lt=edge):
            return f"< {edge}"
    raise TypeError(f"{rule} has no words; write them here")


@cache
def _annotations(target: Callable[..., Any]) -> dict[str, Any]:
    constructor = isinstance(target, type) and not is_dataclass(target)  # a dataclass' inherited fields are its base's
    read = target.__init__ if constructor else target
    found = get_type_hints(read, include_extras=True)
    return {name: annotation for name, annotation in found.items() if name not in ("return", "args", "kwargs")}


@cache
def _adapter(annotation: Any) -> Any:
    from pydantic import ConfigDict, TypeAdapter

    rules = ConfigDict(strict=True, allow_inf_nan=False, arbitrary_types_allowed=True)
    return TypeAdapter(_instances(annotation), config=rules)


def _instances(annotation: Any) -> Any:
    """Replace classes of our own by "an instance of it": what is inside is theirs to check."""
    from pydantic import AfterValidator, InstanceOf

    if get_origin(annotation) in (Union, UnionType):
        return Union[tuple(_instances(argument) for argument in get_args(annotation))]  # noqa: UP007  # of a tuple
    ours = isinstance(annotation, type) and annotation.__module__ not in ("builtins", "typing", "collections.abc")
    if ours and Protocol in annotation.__bases__:
        return Annotated[Any, AfterValidator(_made)]  # asking an object for a protocol computes its properties
    return InstanceOf[annotation] if ours else annotation  # type: ignore[misc]


def _made(value: Any) -> Any:
    if value is None or isinstance(value, bool | int | float | str | Sequence | Mapping):
        raise ValueError("plain data")
    return value
