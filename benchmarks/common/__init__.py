"""What several benchmarks use: tables, the daemon in a process or in a box, statistics of a process."""
