"""Read how foreign joints are written from the options that every command on motion has."""

from __future__ import annotations

import argparse
from dataclasses import fields

from kinema.motion.convention import Convention


def told(options: argparse.Namespace) -> Convention:
    """Return what the command line tells of foreign joints."""
    return Convention(**{field.name: getattr(options, field.name) for field in fields(Convention)})
