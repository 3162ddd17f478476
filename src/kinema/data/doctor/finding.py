"""Hold what the doctor finds, and write it for people."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "info"]
SEVERITIES: tuple[Severity, ...] = ("error", "warning", "info")
SHOWN = 5
"""Items of a finding that are written out."""


@dataclass(frozen=True)
class Finding:
    """Hold one finding: what is wrong, how to put it right, and which clips or files it is about.

    error: results on this corpus would be wrong. warning: they may mislead; look at it. info: worth knowing.
    """

    severity: Severity
    kind: str
    message: str
    fix: str = ""
    items: tuple[str, ...] = ()


def format(findings: Iterable[Finding]) -> str:
    """Write findings, the worst first, with a line that sums them up."""
    found = sorted(findings, key=lambda f: SEVERITIES.index(f.severity))
    lines = []
    for finding in found:
        lines.append(f"{finding.severity:8}{finding.kind}: {finding.message}")
        if finding.items:
            rest = len(finding.items) - SHOWN
            lines.append(f"{'':8}  {', '.join(finding.items[:SHOWN])}" + (f", and {rest} more" if rest > 0 else ""))
        if finding.fix:
            lines.append(f"{'':8}  fix: {finding.fix}")
    counts = [sum(f.severity == s for f in found) for s in SEVERITIES[:2]]
    told = [f"{n} {s}{'' if n == 1 else 's'}" for n, s in zip(counts, SEVERITIES, strict=False)]
    verdict = ", ".join(told) if any(counts) else "nothing is wrong"
    return "\n".join([*lines, f"doctor: {verdict}"])


def exit_code(findings: Iterable[Finding], *, strict: bool = False) -> int:
    """Return the exit code of a command: 1 if there is an error (`strict`: or a warning), else 0."""
    bad = ("error", "warning") if strict else ("error",)
    return int(any(f.severity in bad for f in findings))
