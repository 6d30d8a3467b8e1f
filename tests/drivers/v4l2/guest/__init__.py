"""What runs inside the virtual machine, against the real kernel; ``tests/drivers/v4l2/test_kernel.py`` judges it."""
