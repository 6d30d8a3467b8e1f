"""Errors of the pipeline."""


class PipelineError(ValueError):
    """Base of the pipeline's errors: the input cannot be measured."""


class CalibrationError(PipelineError):
    """A calibration that is inconsistent, or does not fit the images."""


class PatternError(PipelineError):
    """A pattern description that cannot be projected or decoded."""


class ImageError(PipelineError):
    """An image whose size, type or encoding does not fit."""


class TargetError(PipelineError):
    """A calibration board that is invalid or cannot be detected reliably; the message gives the reason."""
