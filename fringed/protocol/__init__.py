"""The protocol of stream and control as tables: topics, parts, status, methods, errors and limits, with their schemas.

``docs/reference/protocol.md`` and the JSON Schemas are generated from these modules; tests compare them with a running
daemon.
"""
