"""Who may read the stream and who may operate the rig from another machine: keys, roles, and the gate that asks."""
