"""Colour calibration of a rig from images of an even white surface.

:func:`color_sequence` is the sequence to be shown, :func:`calibrate_color` computes the models from its images,
:func:`phase_error` checks them on another pattern.
"""

from pipeline.calibrate.color.color_sequence import color_sequence
from pipeline.calibrate.color.phase_error import PhaseError, check_sequence, phase_error
from pipeline.calibrate.color.solution import ColorSolution, calibrate_color

__all__ = ["ColorSolution", "PhaseError", "calibrate_color", "check_sequence", "color_sequence", "phase_error"]
