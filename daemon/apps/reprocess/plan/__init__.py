"""What is to be done: the recordings of some sources, and the chunks of each one."""
