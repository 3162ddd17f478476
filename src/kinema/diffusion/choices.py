"""Name what samplers may be asked for; which of it a process has, its `resolve` says."""

from __future__ import annotations

from typing import Annotated

from kinema.diffusion import ddpm, flow
from kinema.diffusion.grids import GRIDS
from kinema.options import Matches, OneOf, Steps

Solver = Annotated[str, OneOf(ddpm.SOLVERS, flow.SOLVERS)]
SECTIONS = Matches(r"(ddim|leading)?\d+|\d+(,\d+)+", "counts such as 15,15,8, ddim50 or leading50")
SolverSteps = Steps | Annotated[str, SECTIONS]
SolverGrid = Annotated[str, OneOf(GRIDS)]
Holding = Annotated[str, OneOf(flow.HOLDINGS)]
