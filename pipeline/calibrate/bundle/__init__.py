"""Joint bundle adjustment of cameras and projector over views of a board."""

from pipeline.bundle.calibrate import DEVICES, calibrate
from pipeline.bundle.options import Options
from pipeline.bundle.solution import Rejection, Residuals, Solution

__all__ = ["DEVICES", "Options", "Rejection", "Residuals", "Solution", "calibrate"]
