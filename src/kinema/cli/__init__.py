"""Run the command line of `kinema`: train and score methods, generate and edit motion, import, prepare and check."""

from __future__ import annotations

import argparse
import ast
import importlib
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

from kinema.cli.parser import EXPERIMENTS, command_line
from kinema.signals import Interrupted, interruptible

DASHED = {"--up": "-[xyz]", "--hold": r"-\d.*"}
"""Values that begin with a dash, by option."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; an error is one line on stderr and exit code 2 (--debug shows where it came from)."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words and words[0] in EXPERIMENTS:
        module, _, function = EXPERIMENTS[words[0]][0].partition(":")
        getattr(importlib.import_module(module), function)(words[1:])
        return 0
    options = command_line().parse_args(_joined(words))
    try:
        options.set = _settings(options.set)
        with interruptible(), _plain_warnings():
            code = _function(options.command)(options) or 0
        sys.stdout.flush()  # here, so that a reader that is gone is noticed
        return code
    except BrokenPipeError:  # `kinema info RUN | head`: who reads has enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # what a shell says of one that SIGPIPE ended
    except (ValueError, OSError, ImportError) as error:
        if options.debug:
            raise
        from kinema.runs.console import printable  # here too

        print(f"error: {printable(' '.join(str(error).split()))}", file=sys.stderr)
        return 2
    except Interrupted as stop:
        print(f"stopped   {stop}", file=sys.stderr)
        return 128 + stop.signum


def _joined(words: list[str]) -> list[str]:
    """Write `--up -z` as `--up=-z`: argparse takes what begins with a dash for an option."""
    pairs = list(enumerate(pairwise(words)))
    for i in reversed([i for i, (word, value) in pairs if word in DASHED and re.fullmatch(DASHED[word], value)]):
        words[i : i + 2] = [f"{words[i]}={words[i + 1]}"]
    return words


def _function(command: str) -> Callable[[argparse.Namespace], int | None]:
    """Import what does a command: here, so that --help answers at once."""
    module, _, function = command.rpartition(":")
    return getattr(importlib.import_module(f"kinema.cli.{module or 'commands'}"), function)


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Print what users should know as one line, without the place in the code."""
    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, UserWarning):
                print(f"warning: {' '.join(str(message).split())}", file=sys.stderr)
            else:
                usual(message, category, *where, **more)

        warnings.showwarning = show
        yield


def _settings(pairs: list[str]) -> dict[str, Any]:
    """Read KEY=VALUE pairs; values are Python literals, anything else is text."""
    settings = {}
    for pair in pairs:
        key, separator, value = pair.partition("=")
        if not separator:
            raise ValueError(f"--set {pair} is no KEY=VALUE")
        words = {"true": True, "false": False, "null": None, "none": None}
        try:
            settings[key] = words[value.lower()] if value.lower() in words else ast.literal_eval(value)
        except (ValueError, SyntaxError):
            settings[key] = value
    return settings
