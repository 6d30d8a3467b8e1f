"""Control: JSON-RPC 2.0 over ZeroMQ."""
