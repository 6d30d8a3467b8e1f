def cameras() -> None:
    """x."""


projector = color = everything = cameras
