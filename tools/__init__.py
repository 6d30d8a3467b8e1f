"""Programs for building and testing; no part of the installed project."""
