"""The gate process between other machines and the daemon: CURVE sockets, ZAP, and both gates."""
