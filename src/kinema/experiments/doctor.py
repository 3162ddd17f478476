"""Examine the corpus that a configuration names: `make doctor DATA=open_mocap`."""

from __future__ import annotations

import sys

from kinema.data.doctor import diagnose, exit_code, format
from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus


def main(overrides: list[str]) -> int:
    """Prepare the corpus where it isn't yet, print what is wrong with it, and give the exit code."""
    try:
        cfg = compose(overrides)
        findings = diagnose(open_corpus(cfg), source=cfg.data.source)
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(format(findings))
    return exit_code(findings)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
