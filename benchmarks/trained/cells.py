"""Say where a method fails: of each value of a field, such as each pair of action and style, how far its motion is off.

    python benchmarks/trained/cells.py data=open_mocap scale=tiny data.options.split=compositional source=generation
        method=latent_flow scale.protocol.split=val [--field label] [--least 6]

Overrides are those of `kinema evaluate`; its first replication is judged. Printed of each value that has `least` clips,
the worst first: its clips; `off`, the squared distance of its motion's mean embedding from that of captured motion,
times its share of the clips; the matching score of both. FID is of all clips together, so that what is off in one value
may be made up for by another, but a value that is off by far is most of it.
"""

from __future__ import annotations

import argparse
from collections import defaultdict

import torch

from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus
from kinema.experiments.evaluation import describe
from kinema.experiments.scoring import Scorer
from kinema.seeds import protocol_seeds


@torch.no_grad()
def main() -> None:
    """Judge one replication, and print a line for each value."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--field", default="label")
    parser.add_argument("--least", type=int, default=6)
    options = parser.parse_intermixed_args()
    cfg = compose(options.overrides, "evaluate")
    scorer = Scorer(cfg, describe(cfg), open_corpus(cfg))
    protocol, judge, store = scorer.protocol, scorer.matching.eval(), scorer.store
    if options.field not in store.fields:
        parser.error(f"--field {options.field}: {store.name} has {', '.join(store.fields)}")
    values, parts, first = list[str](), list[tuple[torch.Tensor, ...]](), 0
    for batch in scorer.data.test_batches(protocol.split, 0, seed=protocol.seed, batch_size=protocol.pool):
        real = batch.to(scorer.device)
        made = scorer.source(real, protocol_seeds(protocol.seed, 0, first, len(real.lengths)))
        parts.append((judge.embed_motion(made), judge.embed_motion(real), judge.embed_text(real.captions)))
        values += [store.entry_field(entry, options.field) for entry, _, _ in real.crops]
        first += len(real.lengths)
    motion, reference, text = (torch.cat(kind).double().cpu() for kind in zip(*parts, strict=True))
    groups = defaultdict(list)
    for row, value in enumerate(values):
        groups[value].append(row)
    found = []
    for value, rows in groups.items():
        off = (motion[rows].mean(0) - reference[rows].mean(0)).square().sum() * len(rows) / len(values)
        matching = [(kind[rows] - text[rows]).norm(dim=1).mean() for kind in (motion, reference)]
        found.append((float(off), len(rows), value, *matching))
    print(f"{'off':>7} {'clips':>5} {'matching':>8} {'captured':>8}  {options.field}")
    for off, clips, value, own, captured in sorted(found, reverse=True):
        if clips >= options.least:
            print(f"{off:7.3f} {clips:5d} {own:8.2f} {captured:8.2f}  {value}")
    print(f"{sum(one[0] for one in found):7.3f} {len(values):5d} of all {len(found)} values")


if __name__ == "__main__":
    main()
