"""Control of a daemon: addresses, the state of a connection, and the JSON-RPC client."""
