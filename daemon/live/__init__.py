"""The live path: frames are paired, measured, and handed to the sinks."""
