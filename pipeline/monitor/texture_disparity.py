"""Displacement of the right image across the epipolar lines, from the surface texture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.monitor.robust import scale_of

F64 = NDArray[np.float64]

_PASSES = 4
_TUNING = 3.0


def displacement(sums: F64, x: F64, y: F64, *, across: int = 1) -> tuple[F64, F64] | None:
    """Displacement across the epipolar lines, pixels, and its standard deviations, (3,) each.

    The three are the displacement in the middle and its change to the image's edge along x and y. Each patch gives two
    equations of instruments (left gradients); the displacement along the lines, which the phase has determined, is a
    nuisance parameter.

    Args:
        sums: (n, 8), see :data:`pipeline.monitor.brightness.TEXTURE`; x, y: (n,) position in the image, -1 .. 1.
        across: 1 when the epipolar lines run along u, else 0.
    """
    one = np.stack([np.ones_like(x), x, y], axis=1)
    # Equations: [L_u e, L_v e] = [[L_u R_u, L_u R_v], [L_v R_u, L_v R_v]] [du, dv].
    matrix = np.stack([sums[:, 2:4], sums[:, 4:6]], axis=1)
    design = np.concatenate([matrix[:, :, 0:1] * one[:, None], matrix[:, :, 1:2] * one[:, None]], axis=2)
    values = sums[:, :2]
    basis = np.concatenate([np.repeat(one[:, None], 2, axis=1)] * 2, axis=2)
    basis[:, 0, 3:], basis[:, 1, :3] = 0.0, 0.0
    # A patch whose brightness does not fit (an occlusion, a highlight) has a large residual and a small weight.
    residual = np.maximum(sums[:, 6], 0.1 * np.median(sums[:, 6]) + 1e-12)
    weights = steady = np.median(residual) / residual
    spread = np.sqrt(np.maximum(residual * sums[:, 7], 1e-18))
    solution = np.zeros(6)
    for _ in range(_PASSES):
        normal = np.einsum("n,nik,nij->kj", weights, basis, design)
        right = np.einsum("n,nik,ni->k", weights, basis, values)
        if np.linalg.cond(normal) > 1e10:
            return None
        solution = np.linalg.solve(normal, right)
        error = (values[:, across] - design[:, across] @ solution) / spread
        weights = steady * np.minimum(1.0, _TUNING * scale_of(error) / np.maximum(np.abs(error), 1e-12))
    inverse = np.linalg.inv(np.einsum("n,nik,nij->kj", weights, basis, design))
    scores = np.einsum("n,nik,ni->nk", weights, basis, values - design @ solution)
    covariance = inverse @ (scores.T @ scores) @ inverse.T
    which = slice(3 * across, 3 * across + 3)
    return solution[which], np.sqrt(np.maximum(np.diag(covariance)[which], 0.0))
