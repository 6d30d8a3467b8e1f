"""Colour of a rig from images of an even white surface: black, crosstalk, balance, response, lateral colour.

:func:`color_sequence` says what is shown, :func:`calibrate_color` makes the models of it, :func:`phase_error` checks
them on a fresh pattern.
"""

from pipeline.calibrate.color.color_sequence import color_sequence
from pipeline.calibrate.color.phase_error import PhaseError, check_sequence, phase_error
from pipeline.calibrate.color.solution import ColorSolution, calibrate_color

__all__ = ["ColorSolution", "PhaseError", "calibrate_color", "check_sequence", "color_sequence", "phase_error"]
