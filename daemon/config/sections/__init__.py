"""Models of the sections of rig.yaml that have a module of their own."""
