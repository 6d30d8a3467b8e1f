"""Emulated cameras for any GenICam program: a GenTL producer for tests, and the control of what its cameras see.

``build`` compiles the producer, a shared library ``fringed.cti`` that emulates externally triggered cameras with their
registers, sensor, exposure and buffers. ``cable`` is the other side: what happens to a camera (light on its
sensor, edges on its trigger lines, unplugging). Both sides share one directory, FRINGED_GENTL_DIR, that holds for
camera N:

=============  =======================================================================================
``camN.state``  what outlives the process that has the camera open: presence, clock, faults, counters, registers
``camN.img``    the last images shown, as light on the sensor
``camN.sock``   datagrams with edges on the trigger lines; bound by the process that has the camera open
=============  =======================================================================================

No module of this package imports a GenICam library.
"""
