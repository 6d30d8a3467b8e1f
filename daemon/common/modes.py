"""What other users of this machine may do with the files of a rig: nothing."""

from __future__ import annotations

import os


def keep_from_others() -> None:
    """Files that this process makes from now on: for the user, readable by the group, closed to everybody else."""
    os.umask(os.umask(0o027) | 0o027)
