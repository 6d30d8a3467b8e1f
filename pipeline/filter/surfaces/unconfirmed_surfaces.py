"""Surfaces, and parts of them, that nothing beside them confirms and that fit worse than the large ones of the pair.

What is left of a wall that one camera does not see, or that was rejected around it, lies among pixels without points:
phase and brightness go on across its border, but no order does. A true surface ends at depth edges and shadows. Either
may lie beside rejected pixels; a wrong order also agrees less with the projector than the large surfaces do, and its
textures differ. Such a rest may hang together with an object at the depth of its wrong orders; most objects differ from
it in brightness, so that it is a part of their surface between edges (:mod:`.brightness_edges`). See
:mod:`pipeline.filter.surfaces.continued_orders` for the places along the border.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.common.connected_components import Surfaces
from pipeline.filter.surfaces.brightness_edges import DividedSurfaces
from pipeline.filter.surfaces.component_test import reject_surfaces
from pipeline.filter.surfaces.surface_evidence import Figures
from pipeline.fringe_order.margins.order_margins import Continued

LEAST_OPEN = 0.55
"""Share of the places along the border where phase and brightness go on to pixels without a point, or with another
order."""
TIMES_USUAL = 1.5
"""Residual against the projector, rms, in units of that of the large surfaces."""
LEAST_LOSS = 0.65
"""Mean loss of the textures' deviations, in units of that of matched pixels."""
MOSTLY_OPEN, FAR_FROM_USUAL, UNLIKE = 0.75, 3.0, 1.5
"""Such a share, and the residual and the loss one of which is enough then: by chance a wrong order may agree with the
projector as well as a right one, and bare surfaces have no textures that differ."""
TIMES_USUAL_PART, ALL_OPEN = 1.4, 0.9
"""The first of parts of a large surface; the share of their border from which they are rejected however well they fit.
The inside of a surface has no such border."""


def reject_open(
    continued: Continued, surfaces: Surfaces, large: int, valid: NDArray[np.uint8],
    misfits: NDArray[np.bool_] | None = None,
) -> None:  # fmt: skip
    """Reject small surfaces with such a border; ``valid`` (H, W) is changed.

    Args:
        continued: of the surfaces, beside the points of ``valid``; large: pixels from which a surface is not tested.
        misfits: (n,) those that fit worse. None: all, however well they fit, for pairs of which a good part is
            ambiguous. There wrong orders fit as well as right ones, and a wall's remains lie among its rejected parts.
    """
    f = surfaces
    rejected = (f.sizes < large) & (continued.open >= LEAST_OPEN)
    if misfits is not None:
        rejected &= misfits
    if rejected.any():
        reject_surfaces(len(valid), rejected, f.start, f.stop, f.count, f.first, f.surface, valid)


def reject_unconfirmed(
    figures: Figures, continued: Continued, matched_loss: float, surfaces: Surfaces, large: int,
    valid: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Reject those that fit worse than the large surfaces; arguments else as of :func:`reject_open`.

    Args:
        figures: of the surfaces. matched_loss: of :class:`pipeline.filter.texture_agreement.Scale`.
        large: pixels from which a surface is one of those that are compared with; without any, all are.
    """
    usual = usual_rms(figures, surfaces.sizes, large)
    misfits = (figures.rms >= TIMES_USUAL * usual) & (figures.mean_loss >= LEAST_LOSS * matched_loss)
    clearly = (figures.rms >= FAR_FROM_USUAL * usual) | (figures.mean_loss >= UNLIKE * matched_loss)
    misfits |= (continued.open >= MOSTLY_OPEN) & clearly
    reject_open(continued, surfaces, large, valid, misfits)


def usual_rms(figures: Figures, sizes: NDArray[np.int32], large: int) -> float:
    """Mean rms of the large surfaces' residuals, radians; without any, of all, 0 without surfaces."""
    if not len(sizes):
        return 0.0
    small = sizes < large
    return float(np.average(figures.rms, weights=np.where(small & ~small.all(), 0, sizes)))


def reject_parts(
    parts: DividedSurfaces, rms: NDArray[np.float64], usual: float, continued: Continued, label: NDArray[np.uint16],
    sizes: NDArray[np.int32], large: int, valid: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Reject small parts of surfaces with such a border that fit worse; ``valid`` (H, W) is changed.

    Args:
        parts: of the points of ``valid``; rms: (n,) of their residuals, radians, usual: of :func:`usual_rms`.
        continued: of the parts, beside the points of ``valid``.
        label: (H, W), one more than each point's surface; sizes: pixels of the surfaces.
        large: pixels from which a part is not tested, and a surface is large.
    """
    doubtful = (parts.surfaces.sizes < large) & (continued.open >= LEAST_OPEN)
    doubtful &= (rms >= TIMES_USUAL_PART * usual) | (continued.open >= ALL_OPEN)
    if not doubtful.any():
        return
    at = np.flatnonzero(np.append(False, doubtful)[parts.label])
    part, own = parts.label.flat[at].astype(np.int64) - 1, label.flat[at].astype(np.int64) - 1
    of_large = (own >= 0) & (sizes[own] >= large)
    valid.flat[at[of_large | (rms[part] >= FAR_FROM_USUAL * usual)]] = 0
