"""rig.yaml: its model, and a reader that reports every mistake with line and column."""

from daemon.config.load import load_rig, parse_rig
from daemon.config.rig_config import RigConfig

__all__ = ["RigConfig", "load_rig", "parse_rig"]
