"""What can go wrong in the pipeline, each with a name to catch."""


class PipelineError(ValueError):
    """Root of the pipeline's errors: the input cannot be measured as it is."""


class CalibrationError(PipelineError):
    """A calibration that contradicts itself or the images."""


class PatternError(PipelineError):
    """A pattern description that cannot be projected or decoded."""


class ImageError(PipelineError):
    """An image whose size, type or encoding does not fit."""


class TargetError(PipelineError):
    """A calibration board that cannot be described, found or trusted in an image; the message says why."""
