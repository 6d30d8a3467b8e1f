"""JSON-RPC 2.0: the protocol and its server; the client is ``fringed.control``."""
