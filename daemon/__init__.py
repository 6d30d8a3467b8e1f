"""The daemon composes everything: cameras, pairing, pipeline, sinks, control, and the command line."""
