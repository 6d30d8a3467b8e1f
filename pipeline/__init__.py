"""Arrays in, arrays out: phase, fringe order, matching and triangulation.

It uses no clocks, threads, files or sockets. Lengths are in millimetres, angles in radians; pixel (0, 0) is the centre
of the top left pixel.
"""
