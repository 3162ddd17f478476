"""Draw the papers' figures that are no tables: `kinema figures NAME ...`, one module each."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from collections.abc import Sequence

from kinema.experiments.refusals import refusals


@refusals()
def main(arguments: Sequence[str]) -> None:
    """Draw the figure that the first word names; the other words are its own (`kinema figures NAME --help`)."""
    names = sorted(module.name for module in pkgutil.iter_modules(__path__))
    if not arguments or arguments[0] in ("-h", "--help"):
        print(f"usage: kinema figures NAME [-h] ...\n\nNAME is one of {', '.join(names)}")
        sys.exit(0 if arguments else 2)
    if arguments[0] not in names:
        sys.exit(f"error: no figure {arguments[0]}; choose one of {', '.join(names)}")
    importlib.import_module(f"{__name__}.{arguments[0]}").main(list(arguments[1:]))
