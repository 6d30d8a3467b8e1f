"""Whole programs: the loop on emulated hardware, the installed service, the reprocessing of takes."""
