"""Arrays in, arrays out: phase, fringe order, matching and triangulation.

Nothing here knows of clocks, threads, files or sockets. Lengths are millimetres, angles radians, and pixel (0, 0)
is the centre of the top left pixel.
"""
