"""Cameras for any GenICam program, and the light that falls on them: a GenTL producer of our own, for tests.

``build`` compiles the producer, a shared library ``fringed.cti`` that emulates externally triggered cameras with their
registers, sensor, exposure and buffers. ``cable`` is the other side: what a test's world does to a camera (light on
its sensor, edges on its trigger line, a pulled plug). Both sides meet in one directory, named by FRINGED_GENTL_DIR,
that holds for camera N:

=============  =======================================================================================
``camN.state``  what outlives the process that has the camera open: plug, clock, faults, counters, registers
``camN.img``    the last images shown, as light on the sensor
``camN.sock``   datagrams with edges on the trigger lines; bound by the process that has the camera open
=============  =======================================================================================

No module in here imports a GenICam library.
"""
