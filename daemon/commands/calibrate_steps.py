def cameras() -> None:
    """X."""


projector = color = everything = cameras
