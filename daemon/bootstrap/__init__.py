"""The composition root of the measuring process: rig.yaml becomes service, sinks and control; signals."""
