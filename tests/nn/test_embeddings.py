"""Test the sinusoids."""

from __future__ import annotations

import math

import torch

from kinema.nn.embeddings import sinusoidal_positions, timestep_embedding


def test_positions_interleave_sine_and_cosine():
    table = sinusoidal_positions(7, 10)
    for position in (0, 1, 6):
        for pair in range(5):
            angle = position / 10000 ** (2 * pair / 10)
            expected = torch.tensor([math.sin(angle), math.cos(angle)])
            torch.testing.assert_close(table[position, 2 * pair : 2 * pair + 2], expected)


def test_positions_of_odd_width():
    assert sinusoidal_positions(3, 5).shape == (3, 5)


def test_times_put_cosines_first():
    embedding = timestep_embedding(torch.tensor([0.0, 3.5]), 8)
    assert embedding[0].tolist() == [1, 1, 1, 1, 0, 0, 0, 0]
    frequency = 10000 ** (-torch.arange(4) / 4)
    expected = torch.cat(((3.5 * frequency).cos(), (3.5 * frequency).sin()))
    torch.testing.assert_close(embedding[1], expected)
