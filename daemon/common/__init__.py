"""What every part of the daemon may use: errors, clock, counters, queue, threads, files, processes."""
