"""Access from other machines: the gate process that authenticates clients and relays stream and control."""
