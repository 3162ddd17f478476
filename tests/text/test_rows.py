import numpy as np
import pytest
import torch

from kinema.text.rows import SharedRows
from kinema.types import frame_mask

LENGTHS = [[7], [3, 3, 3], [12, 1, 5, 5, 2, 9], [60, 4, 4], *np.random.default_rng(0).integers(1, 40, (4, 32)).tolist()]


@pytest.mark.parametrize("lengths", LENGTHS, ids=lambda lengths: f"{len(lengths)}-{max(lengths)}")
def test_texts_come_back_from_shared_rows_as_they_were(lengths):
    sizes = torch.tensor(lengths)
    mask = frame_mask(sizes, int(sizes.max()))
    values = torch.arange(1, mask.numel() + 1).reshape(mask.shape)
    rows = SharedRows.of(sizes, 48)
    back = rows.take(rows.lay(values, mask)[..., None].float(), mask)[..., 0]
    torch.testing.assert_close(back, values.float() * mask)


@pytest.mark.parametrize("lengths", LENGTHS, ids=lambda lengths: f"{len(lengths)}-{max(lengths)}")
def test_a_text_stands_in_one_piece_and_sees_itself_alone(lengths):
    rows = SharedRows.of(torch.tensor(lengths), 48)
    assert rows.owner.shape[1] <= max(48, *lengths)
    sees = rows.sees()
    for text, size in enumerate(lengths):
        row, column = (rows.owner == text).nonzero(as_tuple=True)
        assert len(set(row.tolist())) == 1
        assert column.tolist() == list(range(int(column[0]), int(column[0]) + size))
        assert rows.place[row, column].tolist() == list(range(size))
        torch.testing.assert_close(sees[row, column], (rows.owner[row] == text))


@pytest.mark.parametrize("lengths", LENGTHS[4:], ids=str)
def test_rows_are_nearly_full(lengths):
    rows = SharedRows.of(torch.tensor(lengths), 48)
    assert (rows.owner >= 0).float().mean() > 0.85  # padded to the longest: about half
