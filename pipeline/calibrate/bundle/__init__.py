"""Joint bundle adjustment of cameras and projector over views of a board."""

from pipeline.calibrate.bundle.calibrate import DEVICES, calibrate
from pipeline.calibrate.bundle.options import Options
from pipeline.calibrate.bundle.solution import Rejection, Residuals, Solution

__all__ = ["DEVICES", "Options", "Rejection", "Residuals", "Solution", "calibrate"]
