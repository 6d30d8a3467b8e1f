"""Calibration drift of a rig, observed in ordinary pairs: the observables and their theory.

**Trinocular residual.** A left pixel, its match in the right image and the projector column that lights the point
measure two unknowns of the point three times. With parallel axes, f and f_p the focal lengths, b and p the
distances from left camera to right camera and to projector: u_L = f X / Z, u_R = f (X - b) / Z, so the expected column
is

    u_P = f_p (X - p) / Z = (f_p / f) ((1 - p/b) u_L + (p/b) u_R),

and an image displacement d changes observed minus expected by (f_p/f)(1 - p/b) d (left) or (f_p/f)(p/b) d (right): for
a projector at 0.382 of the baseline and f_p/f = 1.25, 0.2 px are 0.155 and 0.096 projector px. Yaw by a of a camera
does the same with d = f a (0.60 px for 0.01 degree at f = 3413 px); roll displaces rows at height y by -a y, a slope of
the residual across the image. Residuals are fitted by offset, slope along x and slope along y.

**Epipolar residual.** A displacement e across the epipolar lines does not change the phase where fringes are at right
angles to them. Where the surface is inclined, fringes have a slope g = F_v / F_u (F the phase in the image), and the
match shifts by g e along the line. The regression of the residual on that response yields e, with a standard deviation
that shows whether the scene has enough slopes (a frontal wall has none). The surface's texture yields e again, from the
vertical displacement between the two images (with instruments against the noise of gradients, see
:mod:`pipeline.monitor.brightness`). Both are combined by their variances; without slopes and texture the residual is
not observable.

**Crosstalk.** After unmixing with the calibrated matrix, channel c carries rho_c (A + B cos(Phi + shift_c)). If entry
(c, k) of the true matrix has grown by x, it carries x rho_k (A + B cos(Phi + shift_k)) too, and its phase changes by
x (rho_k / rho_c) sin(shift_k - shift_c): 0.026 rad for x = 0.03 on grey, 0.017 and -0.009 after the mean of the three
channels is subtracted. At x = 0 this is 0 for any colour of the surface: albedo scales a channel without changing its
phase. Lock-in against the smooth phase of the geometry instead of the image's own excludes the ripple of crosstalk.

**Modulation.** B / A of each camera falls with defocus, stray light and motion.
"""

from __future__ import annotations

OBSERVABLES: dict[str, str] = {
    "column_px": "column",
    "column_x_px": "slope",
    "column_y_px": "slope",
    "epipolar_px": "epipolar",
    **{f"{side}_{color}_rad": "color" for side in ("left", "right") for color in ("red", "green", "blue")},
    **{f"{side}_modulation": "modulation" for side in ("left", "right")},
}
"""Every observable and its kind: residual, its slope to the image's edge, projector pixels; epipolar residual, pixels
of the right image; phase of a channel against the mean of the three, rad; fringe amplitude over mean light."""
