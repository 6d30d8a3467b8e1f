"""The median is that of numpy, for even and odd numbers of values."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.common.median import median


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7000, 7001])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_it_is_that_of_numpy(count: int, kind: type) -> None:
    values = np.random.default_rng(count).standard_normal(count).astype(kind)
    before = values.copy()
    assert median(values) == float(np.median(values))
    np.testing.assert_array_equal(values, before)
