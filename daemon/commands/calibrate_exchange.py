def bring() -> None:
    """x."""


def give() -> None:
    """x."""
