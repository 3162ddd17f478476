"""Measure the retrieval of ReMoDiffuse: one product of matrices for a batch, and a loop over the database.

    python benchmarks/retrieval.py [--entries 25000] [--batch 16] [--width 512] [--frames 196] [--turns 5] [--loop 2]

The database is random; frames are held once and each entry is a view of them, as in a real one, so that its size does
not change the search. Both ways answer the same queries, the loop the first few (it is slow), and their answers are
compared. CPU time is counted, on one core.
"""

from __future__ import annotations

import argparse
import os
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import torch

from kinema.generators.remodiffuse.database import RetrievalDatabase, best

MOTIONS, DIM, TOKENS = 64, 263, 12
NEIGHBOURS, LENGTH_WEIGHT = 2, 0.1


def make_database(entries: int, width: int, frames: int) -> RetrievalDatabase:
    """Make a database in which every entry has a text and a length of its own, and a motion shared with others."""
    generator, rows = torch.Generator().manual_seed(0), torch.arange(entries)
    tokens = torch.randn(TOKENS, width, generator=generator)
    return RetrievalDatabase.holding(
        pooled=torch.randn(entries, width, generator=generator),
        tokens=[tokens[:1]] * entries,
        frames=torch.randn(MOTIONS * frames, DIM, generator=generator),
        starts=frames * (rows % MOTIONS),
        lengths=torch.randint(40, frames + 1, (entries,), generator=generator),
        families=rows // 2,
        captions=torch.stack((rows, rows), dim=1),
        names=[str(i) for i in range(entries)],
    )


def looped(database: RetrievalDatabase, pooled: torch.Tensor, length: int) -> list[int]:
    """Score the entries one by one, as the published code does."""
    query, found = pooled / pooled.norm(), []
    lengths = database.lengths.tolist()
    for i in range(len(lengths)):
        gap = abs(lengths[i] - length) / max(lengths[i], length)
        found.append((-float(database.keys[i] @ query) * 2.718281828459045 ** (-LENGTH_WEIGHT * gap), i))
    return [i for _, i in sorted(found)[:NEIGHBOURS]]


def main() -> None:
    """Retrieve both ways; print the time of a query."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--entries", type=int, default=25000)
    parser.add_argument("--batch", type=int, default=16, help="queries that are answered at once (default 16)")
    parser.add_argument("--width", type=int, default=512, help="of the text features (default 512)")
    parser.add_argument("--frames", type=int, default=196, help="of the longest motion (default 196)")
    parser.add_argument("--turns", type=int, default=5, help="batches that are timed (default 5)")
    parser.add_argument("--loop", type=int, default=2, help="queries of the loop (default 2)")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    database = make_database(arguments.entries, arguments.width, arguments.frames)
    generator = torch.Generator().manual_seed(1)
    pooled = torch.randn(arguments.batch, arguments.width, generator=generator)
    lengths = torch.randint(40, arguments.frames + 1, (arguments.batch,), generator=generator)

    def rows() -> torch.Tensor:
        return best(database.scores(pooled, lengths, length_weight=LENGTH_WEIGHT), NEIGHBOURS)

    found = rows()  # a warm-up
    start = time.process_time()
    for _ in range(arguments.turns):
        rows()
    searched = (time.process_time() - start) / arguments.turns / arguments.batch
    start = time.process_time()
    for _ in range(arguments.turns):
        database.gather(found)
    gathered = (time.process_time() - start) / arguments.turns / arguments.batch
    count, start = min(arguments.loop, arguments.batch), time.process_time()
    same = [looped(database, pooled[i], int(lengths[i])) == found[i].tolist() for i in range(count)]
    slow = (time.process_time() - start) / count
    print(f"{arguments.entries} entries, batches of {arguments.batch}: {1e3 * searched:.2f} ms a query to search,")
    print(f"{1e3 * gathered:.2f} ms to gather {NEIGHBOURS} motions; a loop takes {1e3 * slow:.0f} ms to search")
    print(f"ratio {slow / searched:.0f}; {sum(same)} of {count} answers are the same")


if __name__ == "__main__":
    main()
