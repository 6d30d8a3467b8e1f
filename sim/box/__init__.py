"""A rig in a box: the real drivers on an X server without hardware, emulated cameras, and rendered light in between."""
